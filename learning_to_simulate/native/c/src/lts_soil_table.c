/* Reads the tables of inputs that come with a model, for many places side by side. Twin of `Inputs._read` and
 * `_at` of `soil_field/network.py`, in its float32. */
#include <math.h>
#include <string.h>

#include "lts_soil_internal.h"

#define LANES LTS_SOIL_LANES
#define SLOTS 40 /* offsets whose bins are kept, more are found anew */

typedef struct {
  int32_t low[LANES];
  float share[LANES];
} lanes_at;
typedef struct {
  const lts_soil *soil;
  const lts_table *table;
  const lts_places *places;
  const float *base;
  const int32_t *other;
  int n, n_strip, n_slot;
  float offsets[SLOTS];
  lanes_at at[SLOTS + 1];
} reading;

#define EACH(expression) \
  for (int i = 0; i < n; ++i) x[i] = (expression)

/* Bins below places and the shares of the next ones; beyond the ends the ends. */
static void find_bins(const lts_soil_model *m, const float *base, float offset, int n, lanes_at *at) {
  const float first = (float)lts_soil_offset(m, 0), width = (float)m->spacing;
  const float last = (float)(m->n_bin - 1);
  for (int i = 0; i < n; ++i) {
    float bin = (base[i] + offset - first) / width;
    bin = bin > 0.0f ? bin : 0.0f;
    bin = bin < last ? bin : last;
    int32_t low = (int32_t)bin;
    low = low < m->n_bin - 2 ? low : m->n_bin - 2;
    at->low[i] = low;
    at->share[i] = bin - (float)low;
  }
}

lts_spot lts_soil_spot(const lts_soil *soil, int n_strip, int strip, float share, float u) {
  lanes_at at;
  find_bins(soil->model, &u, 0.0f, 1, &at);
  const lts_spot spot = {LTS_SOIL_ROW(soil, strip) + (size_t)at.low[0], strip + 1 < n_strip, at.share[0], share};
  return spot;
}

float lts_soil_channel(const lts_soil *soil, int channel, const lts_spot *spot) {
  const float *c = soil->bins[channel] + spot->bin;
  const float here = c[0] + spot->along * (c[1] - c[0]);
  if (!spot->has_next) return here;
  c += soil->model->n_bin;
  return here + spot->across * (c[0] + spot->along * (c[1] - c[0]) - here);
}

float lts_soil_channel_at(const lts_soil *soil, int channel, int n_strip, int strip, float share, float u) {
  const lts_spot spot = lts_soil_spot(soil, n_strip, strip, share, u);
  return lts_soil_channel(soil, channel, &spot);
}

static const lanes_at *at_offset(reading *r, float offset) {
  int slot = 0;
  while (slot < r->n_slot && r->offsets[slot] != offset) ++slot;
  if (slot < r->n_slot) return &r->at[slot];
  if (r->n_slot < SLOTS) r->offsets[r->n_slot++] = offset;
  find_bins(r->soil->model, r->base, offset, r->n, &r->at[slot]);
  return &r->at[slot];
}

/* A channel at an offset from each of the places. */
static void look(reading *r, int channel, float offset, float *x) {
  const lanes_at *at = at_offset(r, offset);
  const float *c = r->soil->bins[channel], *share = r->places->share[0];
  const int32_t *strip = r->places->strip[0];
  const int n = r->n, width = r->soil->model->n_bin;
  if (r->n_strip == 1) {
    for (int i = 0; i < n; ++i) {
      const float *near = c + at->low[i];
      x[i] = near[0] + at->share[i] * (near[1] - near[0]);
    }
    return;
  }
  for (int i = 0; i < n; ++i) {
    const float *near = c + strip[i] * width + at->low[i], *next = near + width, a = at->share[i];
    const float low = near[0] + a * (near[1] - near[0]), high = next[0] + a * (next[1] - next[0]);
    x[i] = low + share[i] * (high - low);
  }
}

/* The ground of neighbours: their surface without their cut. */
static void look_beside(reading *r, float offset, float *x) {
  const lanes_at *at = at_offset(r, offset);
  const float *surface = r->soil->bins[LTS_SOIL_SURFACE], *cut = r->soil->bins[LTS_SOIL_CUT];
  for (int i = 0; i < r->n; ++i) {
    const int k = r->other[i] * r->soil->model->n_bin + at->low[i];
    const float a = at->share[i];
    x[i] = surface[k] + a * (surface[k + 1] - surface[k]) - (cut[k] + a * (cut[k + 1] - cut[k]));
  }
}

void lts_soil_scalars_of_strip(const lts_soil_model *m, int out[LTS_SOIL_OF_STRIP]) {
  const int found[LTS_SOIL_OF_STRIP] = {LTS_SOIL_AREA, LTS_SOIL_FOREMOST, LTS_SOIL_OF_PASSAGE(m, CARRIED),
                                        LTS_SOIL_OF_PASSAGE(m, LAYER), LTS_SOIL_OF_PASSAGE(m, PRESSED)};
  memcpy(out, found, sizeof found);
}

static void scalar_of(const reading *r, int index, float *x) {
  const int n = r->n;
  const float value = r->soil->scalars[0][index];
  int of_strip[LTS_SOIL_OF_STRIP], s = 0;
  lts_soil_scalars_of_strip(r->soil->model, of_strip);
  while (s < LTS_SOIL_OF_STRIP && of_strip[s] != index) ++s;
  if (s < LTS_SOIL_OF_STRIP) memcpy(x, r->places->of_strip[s], (size_t)n * sizeof *x);
  else EACH(value);
}

/* The operand of a row, into the lowest [LANES] of a stack. */
static void operand_of(reading *r, const lts_row *row, float stack[LTS_STACK][LANES]) {
  const int n = r->n;
  const float *rest[3] = {r->places->u, r->places->y, r->places->z};
  int top = -1;
  for (int k = 0; k < row->count; ++k) {
    const lts_op *op = &r->table->ops[row->first + k];
    const int takes_two = op->code >= LTS_OP_ADD && op->code <= LTS_OP_SUB;
    top += op->code < LTS_OP_ADD ? 1 : takes_two ? -1 : 0;
    float *restrict x = stack[top];
    const float *restrict y = stack[top + 1];
    switch (op->code) {
      case LTS_OP_SCALAR: scalar_of(r, op->index, x); break;
      case LTS_OP_NUMBER: EACH(op->value); break;
      case LTS_OP_REST: memcpy(x, rest[op->index], (size_t)n * sizeof *x); break;
      case LTS_OP_HERE: memcpy(x, r->places->here[op->index], (size_t)n * sizeof *x); break;
      case LTS_OP_AT:
        if (op->index == LTS_SOIL_BESIDE) {
          look_beside(r, op->value, x);
        } else {
          look(r, op->index, op->value, x);
        }
        break;
      case LTS_OP_ADD: EACH(x[i] + y[i]); break;
      case LTS_OP_SUB: EACH(x[i] - y[i]); break;
      case LTS_OP_ABS: EACH(fabsf(x[i])); break;
      case LTS_OP_RELU: EACH(x[i] < 0.0f ? 0.0f : x[i]); break;
      case LTS_OP_SQRT: EACH(sqrtf(x[i])); break;
      default: break;
    }
  }
}

static void tanh_of(const reading *r, float *x) {
  for (int i = r->n; i < LTS_PADDED(r->n); ++i) x[i] = 0.0f;
  r->soil->run->tanh_of(x, LTS_PADDED(r->n), x);
}

/* exp(-x) = (1 - t) / (1 + t), t = tanh(x / 2). */
static void exp_minus(const reading *r, float *x) {
  const int n = r->n;
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
    default: break;
  }
}

void lts_soil_inputs(const lts_soil *soil, const lts_table *table, const lts_places *places,
                     int n_strip, const float *base, const int32_t *other, float *out, int ld) {
  float stack[LTS_STACK + 1][LANES];
  reading r;
  r.soil = soil;
  r.table = table;
  r.places = places;
  r.base = base;
  r.other = other;
  r.n = places->n;
  r.n_strip = n_strip;
  r.n_slot = 0;
  for (int column = 0; column < table->n_row; ++column) {
    const lts_row *row = &table->rows[column];
    operand_of(&r, row, stack);
    squash(&r, row, stack[0]);
    for (int i = 0; i < r.n; ++i) out[i * ld + column] = stack[0][i];
  }
}
