/* What both kinds of models need. */
#include "lts_common.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

int lts_check(const void *instance) {
  if (!instance) return LTS_ERROR_NULL;
  if ((uintptr_t)instance % LTS_ALIGNMENT) return LTS_ERROR_MEMORY;
  return *(const uint32_t *)instance == LTS_MAGIC ? LTS_OK : LTS_ERROR_MEMORY;
}

void *lts_cleared(void *memory, size_t n) {
  char *base = (char *)memory + (LTS_ALIGNMENT - (uintptr_t)memory % LTS_ALIGNMENT) % LTS_ALIGNMENT;
  return memset(base, 0, n);
}

size_t lts_aligned(size_t n, size_t to) { return (n + to - 1) / to * to; }

int lts_all_finite(const double *values, size_t n) {
  for (size_t i = 0; i < n; ++i) {
    if (!isfinite(values[i])) return 0;
  }
  return 1;
}

double lts_length(const double *values, int n) {
  double square = 0.0;
  for (int i = 0; i < n; ++i) square += values[i] * values[i];
  return sqrt(square);
}

void lts_centroid(const double *points, int n, double out[3]) {
  out[0] = out[1] = out[2] = 0.0;
  for (int i = 0; i < 3 * n; ++i) out[i % 3] += points[i] / n;
}

const char *lts_error_text(int error) {
  switch (error) {
    case LTS_ERROR_NULL: return "a pointer that is needed is null";
    case LTS_ERROR_MODEL: return "the model is of another ABI version than this library";
    case LTS_ERROR_MEMORY: return "too little memory, or memory that holds no instance";
    case LTS_ERROR_CALL: return "not started, or a call that this model does not take";
    case LTS_ERROR_VALUE: return "a number is not finite or outside its range";
    case LTS_ERROR_STATE: return "the saved state is damaged or belongs to another model";
    case LTS_ERROR_JUMP: return "the pose jumps: no tool is so fast; start anew";
    case LTS_ERROR_PLACE: return "the tool would be under the floor of the bed or beyond its bins";
    default: return error < 0 ? "unknown error" : "no error";
  }
}

void lts_rotate(const double q[4], const double v[3], double out[3]) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  const double rows[3][3] = {
      {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
      {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
      {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)},
  };
  double rotated[3];
  for (int i = 0; i < 3; ++i) {
    rotated[i] = rows[i][0] * v[0] + rows[i][1] * v[1] + rows[i][2] * v[2];
  }
  memcpy(out, rotated, sizeof rotated);
}

int lts_usable_pose(const lts_pose *pose, lts_pose *out) {
  const double length = lts_length(pose->rotation, 4);
  if (!lts_all_finite(pose->position, 3) || !(length > 1e-6 && length < 1e6)) return 0;
  *out = *pose;
  for (int i = 0; i < 4; ++i) out->rotation[i] /= length;
  return 1;
}

int lts_usable_twist(const lts_twist *twist) {
  return lts_all_finite(twist->linear, 3) && lts_all_finite(twist->angular, 3);
}

void lts_moved_pose(const lts_pose *pose, const lts_twist *twist, double seconds, lts_pose *out) {
  const double *w = twist->angular, *q = pose->rotation;
  const double rate = lts_length(w, 3), half = 0.5 * rate * seconds;
  const double s = rate > 0.0 ? sin(half) / rate : 0.0, c = cos(half);
  const double t[4] = {c, s * w[0], s * w[1], s * w[2]};
  const double turned[4] = {
      t[0] * q[0] - t[1] * q[1] - t[2] * q[2] - t[3] * q[3],
      t[0] * q[1] + t[1] * q[0] + t[2] * q[3] - t[3] * q[2],
      t[0] * q[2] - t[1] * q[3] + t[2] * q[0] + t[3] * q[1],
      t[0] * q[3] + t[1] * q[2] - t[2] * q[1] + t[3] * q[0],
  };
  for (int i = 0; i < 3; ++i) out->position[i] = pose->position[i] + twist->linear[i] * seconds;
  memcpy(out->rotation, turned, sizeof turned);
}

/* ---- reasons ---- */

const lts_judgement lts_well = {LTS_OK, -1, -1, -1, 0.0, 0.0, 0.0};

void lts_say(const lts_judgement *found, const char *measure, char *text, size_t size) {
  const char *twice = found->status & LTS_LEFT_BOUNDS ? "twice " : "";
  if (!found->status) {
    snprintf(text, size, "%s", "");
  } else if (found->status & LTS_NON_FINITE) {
    snprintf(text, size, "%s is not finite", measure);
  } else {
    snprintf(text, size, "%s %.4g is outside %s[%.4g, %.4g] of training", measure,
             found->value + 0.0 /* a 0 without sign */, twice, found->low, found->high);
  }
}

void lts_name_of(const char *names, int index, char *name, size_t size) {
  for (; index > 0 && *names; ++names) index -= *names == ',';
  snprintf(name, size, "%.*s", (int)strcspn(names, ","), names);
}

/* ---- saved bytes ---- */

typedef struct {
  uint32_t magic; /* also tells the byte order */
  int32_t abi;
  uint64_t size, checksum;
  char digest[64], unused[8];
} saved;
/* An array of -1 elements where the header has another size than lts_common.h says. */
typedef char saved_has_its_size[sizeof(saved) == LTS_HEADER_SIZE ? 1 : -1];

/* FNV-1a of 64 bit over words of 8 bytes: a state is a multiple of them. */
static uint64_t checksum_of(const void *bytes, size_t size) {
  uint64_t sum = 14695981039346656037ull, word;
  for (size_t i = 0; i + sizeof word <= size; i += sizeof word) {
    memcpy(&word, (const char *)bytes + i, sizeof word);
    sum = (sum ^ word) * 1099511628211ull;
    sum ^= sum >> 32; /* a multiplication alone carries no bit down */
  }
  return sum;
}

static saved header_of(const char *digest, const void *state, size_t n) {
  saved header;
  memset(&header, 0, sizeof header);
  header.magic = LTS_MAGIC;
  header.abi = LTS_ABI;
  header.size = n;
  header.checksum = checksum_of(state, n);
  for (size_t i = 0; i < sizeof header.digest && digest[i]; ++i) header.digest[i] = digest[i];
  return header;
}

int lts_write_state(const char *digest, const void *state, size_t n, void *bytes, size_t size) {
  if (!bytes) return LTS_ERROR_NULL;
  if (size < LTS_HEADER_SIZE + n) return LTS_ERROR_MEMORY;
  const saved header = header_of(digest, state, n);
  memcpy(bytes, &header, sizeof header);
  memmove((char *)bytes + LTS_HEADER_SIZE, state, n); /* it may lie there already */
  return LTS_OK;
}

int lts_check_state(const char *digest, const void *bytes, size_t size, size_t n) {
  if (!bytes) return LTS_ERROR_NULL;
  if (size < LTS_HEADER_SIZE + n) return LTS_ERROR_STATE;
  const saved wanted = header_of(digest, (const char *)bytes + LTS_HEADER_SIZE, n);
  return memcmp(bytes, &wanted, sizeof wanted) ? LTS_ERROR_STATE : LTS_OK;
}
