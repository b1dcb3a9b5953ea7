/* Reads the tables of inputs that come with a model: x = squash((operand - shift) / scale), an operand being
 * a short program for a stack. Twin of `tool/inputs.py` as `network.py` reads it, in its float32; many particles
 * go side by side. */
#include <math.h>
#include <string.h>

#include "lts_field_internal.h"

#define LANES LTS_FIELD_ROWS
typedef struct {
  int low;
  float share;
} place;
typedef struct {
  const lts_field *soil;
  const lts_table *table;
  int n, is_particles;
  place here[LANES]; /* of particles, in bins */
  float rest[3][LANES], seen[LTS_CHANNELS][LANES];
  int has_seen[LTS_CHANNELS];
} reading;

static place place_at(const lts_field_model *m, float u) {
  const float last = (float)(m->n_bin - 1);
  float bin = (u - m->first_bin) / m->bin_width;
  bin = bin > 0.0f ? (bin < last ? bin : last) : 0.0f;
  place at = {(int)bin, 0.0f};
  if (at.low > m->n_bin - 2) at.low = m->n_bin - 2;
  at.share = bin - (float)at.low;
  return at;
}

static float between(const float *channel, place at) {
  return (1.0f - at.share) * channel[at.low] + at.share * channel[at.low + 1];
}

float lts_field_channel_at(const lts_field *soil, int channel, float u) {
  return between(soil->bins[channel], place_at(soil->model, u));
}

/* A channel at an offset from each of the places that the table looks at. */
static void look(const reading *r, int channel, float offset, float *out) {
  const lts_field_model *m = r->soil->model;
  const float *bins = r->soil->bins[channel], *s = r->soil->scalars;
  if (!r->is_particles) {
    const float unit = r->table->unit < 0 ? 1.0f : s[r->table->unit];
    out[0] = between(bins, place_at(m, s[r->table->place] + unit * offset));
    return;
  }
  /* Whole bins and a share of the next one are added to those of a particle. */
  const double way = (double)offset / m->bin, whole = floor(way + 1e-5);
  const int bin = (int)whole;
  const float share = way - whole < 1e-5 ? 0.0f : (float)(way - whole);
  for (int i = 0; i < r->n; ++i) {
    const float sum = r->here[i].share + share;
    const int more = sum >= 1.0f;
    const place at = {r->here[i].low + bin + more, sum - (float)more};
    out[i] = between(bins, at);
  }
}

static const float *seen_here(reading *r, int channel) {
  if (!r->has_seen[channel]) look(r, channel, 0.0f, r->seen[channel]);
  r->has_seen[channel] = 1;
  return r->seen[channel];
}

#define EACH(expression) \
  for (int i = 0; i < n; ++i) x[i] = (expression)

/* The operand of a row, into the lowest [LANES] of a stack. */
static void operand_of(reading *r, const lts_row *row, float stack[LTS_STACK][LANES]) {
  const int n = r->n;
  int top = -1;
  for (int k = 0; k < row->count; ++k) {
    const lts_op *op = &r->table->ops[row->first + k];
    const int takes_two = op->code >= LTS_OP_ADD && op->code <= LTS_OP_MAX;
    top += op->code < LTS_OP_ADD ? 1 : takes_two ? -1 : 0;
    float *x = stack[top];
    const float *y = takes_two ? stack[top + 1] : x;
    switch (op->code) {
      case LTS_OP_SCALAR: EACH(r->soil->scalars[op->index]); break;
      case LTS_OP_NUMBER: EACH(op->value); break;
      case LTS_OP_REST: memcpy(x, r->rest[op->index], (size_t)n * sizeof *x); break;
      case LTS_OP_HERE: memcpy(x, seen_here(r, op->index), (size_t)n * sizeof *x); break;
      case LTS_OP_AT: look(r, op->index, op->value, x); break;
      case LTS_OP_ADD: EACH(x[i] + y[i]); break;
      case LTS_OP_SUB: EACH(x[i] - y[i]); break;
      case LTS_OP_MUL: EACH(x[i] * y[i]); break;
      case LTS_OP_DIV: EACH(x[i] / y[i]); break;
      case LTS_OP_MAX: EACH(x[i] < y[i] ? y[i] : x[i]); break;
      case LTS_OP_SQUARE: EACH(x[i] * x[i]); break;
      case LTS_OP_ABS: EACH(fabsf(x[i])); break;
      case LTS_OP_RELU: EACH(x[i] < 0.0f ? 0.0f : x[i]); break;
      case LTS_OP_SQRT: EACH(sqrtf(x[i])); break;
      case LTS_OP_LOG: EACH(logf(x[i])); break;
      case LTS_OP_LOG1P: EACH(log1pf(x[i])); break;
      default: break;
    }
  }
}

static void tanh_of(const reading *r, float *x) {
  if (!r->is_particles) {
    x[0] = tanhf(x[0]);
    return;
  }
  for (int i = r->n; i < LTS_PADDED(r->n); ++i) x[i] = 0.0f;
  r->soil->run->tanh_of(x, LTS_PADDED(r->n), x);
}

/* exp(-x) = (1 - t) / (1 + t), t = tanh(x / 2). */
static void exp_minus(const reading *r, float *x) {
  const int n = r->n;
  if (!r->is_particles) {
    x[0] = expf(-x[0]);
    return;
  }
  EACH(0.5f * x[i]);
  tanh_of(r, x);
  EACH((1.0f - x[i]) / (1.0f + x[i]));
}

static void squash(const reading *r, const lts_row *row, float *x) {
  const int n = r->n;
  if (row->shift != 0.0f) EACH(x[i] - row->shift);
  if (row->scale != 1.0f) EACH(x[i] / row->scale);
  switch (row->squash) {
    case LTS_SQUASH_TANH: tanh_of(r, x); break;
    case LTS_SQUASH_RELU: EACH(x[i] < 0.0f ? 0.0f : x[i]); break;
    case LTS_SQUASH_RELU2: EACH(x[i] < 0.0f ? 0.0f : x[i] * x[i]); break;
    case LTS_SQUASH_BELL:
      EACH(x[i] * x[i]);
      exp_minus(r, x);
      break;
    case LTS_SQUASH_FADE: exp_minus(r, x); break;
    case LTS_SQUASH_LOG: EACH(logf(x[i])); break;
    case LTS_SQUASH_LOG1P: EACH(log1pf(x[i])); break;
    default: break;
  }
}

static void read_rows(reading *r, float *out, int ld) {
  float stack[LTS_STACK][LANES];
  for (int column = 0; column < r->table->n_row; ++column) {
    const lts_row *row = &r->table->rows[column];
    operand_of(r, row, stack);
    squash(r, row, stack[0]);
    for (int i = 0; i < r->n; ++i) out[i * ld + column] = stack[0][i];
  }
}

void lts_field_read(const lts_field *soil, const lts_table *table, float *out) {
  reading r;
  r.soil = soil;
  r.table = table;
  r.n = 1;
  r.is_particles = 0;
  read_rows(&r, out, 0);
}

void lts_field_read_particles(const lts_field *soil, const int32_t *which, int n, float *out, int ld) {
  reading r;
  r.soil = soil;
  r.table = &soil->model->own;
  r.n = n;
  r.is_particles = 1;
  memset(r.has_seen, 0, sizeof r.has_seen);
  for (int i = 0; i < n; ++i) {
    const int k = which[i];
    r.rest[0][i] = soil->u[k];
    r.rest[1][i] = soil->y[k];
    r.rest[2][i] = soil->z[k];
    r.here[i].low = soil->low[k];
    r.here[i].share = soil->share[k];
  }
  read_rows(&r, out, ld);
}
