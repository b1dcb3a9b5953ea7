/* Memory of a swept field, save and load. */
#include <math.h>
#include <string.h>

#include "lts_field_internal.h"

static int is_usable(const lts_field_model *m) { return m && m->abi == LTS_ABI; }

static const lts_field_tool *tool_of(const lts_field_model *m) {
  return m->tool == LTS_FIELD_WHEEL ? &lts_field_wheel : &lts_field_blade;
}

int lts_field_describe(const lts_field_model *m, lts_field_description *out) {
  if (!m || !out) return LTS_ERROR_NULL;
  if (!is_usable(m)) return LTS_ERROR_MODEL;
  lts_field_description d;
  memset(&d, 0, sizeof d);
  d.abi = m->abi;
  d.n_soil = m->n_soil;
  d.n_member = m->n_member;
  d.n_scalar = m->n_scalar + LTS_FIELD_CONDITIONS;
  d.up_axis = m->up;
  d.travel_axis = m->axis;
  d.travel_sign = m->sign;
  d.has_bound = m->bound != NULL;
  d.tool = m->tool;
  d.n_context = m->n_context;
  d.n_start = m->n_start;
  d.roll_sign = -m->turn;
  d.load = m->load;
  d.dt = m->dt;
  d.blade_width = m->width;
  d.blade_radius = m->blade_radius;
  d.blade_length = m->length;
  d.floor = HUGE_VAL;
  for (int i = 0; i < m->n_soil; ++i) d.floor = fmin(d.floor, m->rest[3 * i + m->up]);
  d.floor -= 0.5 * m->spacing;
  d.level = m->level;
  memcpy(d.start, m->start, sizeof d.start);
  d.name = m->name;
  d.digest = m->digest;
  d.scalar_names = m->scalar_names;
  d.context_names = m->context_names;
  *out = d;
  return LTS_OK;
}

size_t lts_field_bytes(const lts_field_model *m, int has_bed) {
  size_t bytes = lts_aligned(sizeof(lts_field_head), 8);
  bytes += (size_t)(tool_of(m)->n_row * m->n_bin) * sizeof(double);
  return bytes + (has_bed ? lts_aligned(3 * (size_t)m->n_soil * sizeof(float), 8) : 0);
}

size_t lts_field_lay_out(const lts_field_model *m, char *base, lts_field *soil) {
  const size_t n = (size_t)m->n_soil, bins = (size_t)m->n_bin, rows = LTS_FIELD_ROWS;
  const size_t latent = (size_t)LTS_PADDED(m->latent);
  const size_t of_load = (size_t)(m->n_member * LTS_PADDED(m->load_latent));
  const size_t width = latent * rows > of_load ? latent * rows : of_load;
  size_t at = lts_aligned(sizeof(lts_field), LTS_ALIGNMENT);
  if (base) {
    char *state = base + at;
    soil->head = (lts_field_head *)(void *)state;
    soil->surface = (double *)(void *)(state + lts_aligned(sizeof(lts_field_head), 8));
    soil->profile = soil->surface + bins;
    soil->last = soil->profile + bins;
    soil->area_before = soil->first = soil->last + bins;
    if (m->tool == LTS_FIELD_WHEEL) {
      soil->slid = soil->first + bins;
      soil->shear = soil->slid + bins;
      soil->peak = soil->shear + bins;
    }
    soil->bed = (float *)(void *)(state + lts_field_bytes(m, 0));
  }
  at += lts_aligned(lts_field_bytes(m, 1), LTS_ALIGNMENT);
#define TAKE(field, type, count)                             \
  if (base) soil->field = (type *)(void *)(base + at);       \
  at += lts_aligned((count) * sizeof(type), LTS_ALIGNMENT);
  for (int k = 0; k < LTS_CHANNELS; ++k) {
    TAKE(bins[k], float, bins + 4 * (size_t)m->n_pad + 1)
    if (base) soil->bins[k] += 2 * m->n_pad;
  }
  TAKE(u, float, n)
  TAKE(y, float, n)
  TAKE(z, float, n)
  TAKE(share, float, n)
  TAKE(beside, float, n)
  TAKE(low, int32_t, n)
  TAKE(moving, int32_t, n)
  TAKE(gate, float, n)
  TAKE(points, float, 3 * n)
  TAKE(seen, float, rows * (size_t)LTS_PADDED(m->n_seen > m->n_force ? m->n_seen : m->n_force))
  TAKE(shared, float, (size_t)LTS_PADDED(m->n_shared))
  TAKE(bias, float, (size_t)m->n_member * latent)
  TAKE(a, float, width)
  TAKE(b, float, width)
  TAKE(out, float, rows * LTS_PANEL)
  TAKE(top, double, 2 * n > bins ? 2 * n : bins)
  TAKE(median, double, 2 * n > bins ? 2 * n : bins)
  TAKE(heights, double, bins)
  TAKE(before, char, lts_field_bytes(m, 0))
#undef TAKE
  return at;
}

size_t lts_field_size(const lts_field_model *m) {
  return is_usable(m) ? lts_field_lay_out(m, NULL, NULL) + LTS_ALIGNMENT - 1 : 0;
}

int lts_field_init(const lts_field_model *m, void *memory, size_t size, int kernel,
                   lts_field **out) {
  if (!m || !memory || !out) return LTS_ERROR_NULL;
  if (!is_usable(m)) return LTS_ERROR_MODEL;
  if (size < lts_field_size(m)) return LTS_ERROR_MEMORY;
  int found = 0;
  const lts_kernels *run = lts_find_kernels(kernel, &found);
  if (!run) return LTS_ERROR_VALUE;
  char *base = (char *)memory;
  base += (LTS_ALIGNMENT - (uintptr_t)base % LTS_ALIGNMENT) % LTS_ALIGNMENT;
  memset(base, 0, lts_field_lay_out(m, NULL, NULL));
  lts_field *soil = (lts_field *)(void *)base;
  lts_field_lay_out(m, base, soil);
  soil->model = m;
  soil->run = run;
  soil->tool = tool_of(m);
  soil->kernel = found;
  soil->of_force = soil->of_particles = m->n_member;
  soil->magic = LTS_FIELD_MAGIC;
  *out = soil;
  return LTS_OK;
}

int lts_field_check(const lts_field *soil) {
  if (!soil) return LTS_ERROR_NULL;
  if ((uintptr_t)soil % LTS_ALIGNMENT || soil->magic != LTS_FIELD_MAGIC) return LTS_ERROR_MEMORY;
  return LTS_OK;
}

int lts_field_check_started(const lts_field *soil) {
  LTS_TRY(lts_field_check(soil));
  return soil->head->started ? LTS_OK : LTS_ERROR_CALL;
}

int lts_field_kernel(const lts_field *soil) {
  const int error = lts_field_check(soil);
  return error ? error : soil->kernel;
}

int lts_field_members(lts_field *soil, int of_force, int of_particles) {
  LTS_TRY(lts_field_check(soil));
  const int most = soil->model->n_member;
  if (of_force < 1 || of_force > most || of_particles < 1 || of_particles > most) {
    return LTS_ERROR_VALUE;
  }
  soil->of_force = of_force;
  soil->of_particles = of_particles;
  soil->placed = 0;
  return LTS_OK;
}

size_t lts_field_state_size(const lts_field *soil) {
  if (lts_field_check(soil)) return 0;
  return LTS_HEADER_SIZE + lts_field_bytes(soil->model, soil->head->has_bed);
}

int lts_field_save(const lts_field *soil, void *bytes, size_t size) {
  LTS_TRY(lts_field_check(soil));
  const lts_field_model *m = soil->model;
  const size_t n = lts_field_bytes(m, soil->head->has_bed);
  return lts_write_state(LTS_FIELD_MAGIC, m->digest, soil->head, n, bytes, size);
}

int lts_field_load(lts_field *soil, const void *bytes, size_t size) {
  LTS_TRY(lts_field_check(soil));
  if (!bytes) return LTS_ERROR_NULL;
  const lts_field_model *m = soil->model;
  const char *state = (const char *)bytes + LTS_HEADER_SIZE;
  lts_field_head head;
  if (size < LTS_HEADER_SIZE + sizeof head) return LTS_ERROR_STATE;
  memcpy(&head, state, sizeof head);
  const size_t n = lts_field_bytes(m, head.has_bed);
  LTS_TRY(lts_check_state(LTS_FIELD_MAGIC, m->digest, bytes, size, n));
  /* A checksum can be forged: only what could lead a read or write astray matters. */
  const double offset = head.position[0] - head.ground.origin - m->first;
  if (!(offset >= 0.0 && offset <= (m->n_bin - 1) * m->bin) && head.started) return LTS_ERROR_STATE;
  memcpy(soil->head, state, n);
  soil->placed = 0;
  if (head.has_bed) soil->has_local = 0;
  return LTS_OK;
}

int lts_field_clone(lts_field *to, const lts_field *from) {
  LTS_TRY(lts_field_check(to) ? lts_field_check(to) : lts_field_check(from));
  if (strcmp(to->model->digest, from->model->digest)) return LTS_ERROR_STATE;
  if (to == from) return LTS_OK;
  memcpy(to->head, from->head, lts_field_bytes(to->model, from->head->has_bed));
  to->placed = 0;
  if (from->head->has_bed) to->has_local = 0;
  return LTS_OK;
}
