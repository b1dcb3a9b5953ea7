/* What the inputs of both tools are made of: values of bins between their centres, and columns of many
 * particles that are a tanh or an exp. */
#ifndef LTS_FIELD_PLACES_H
#define LTS_FIELD_PLACES_H

#include <math.h>

#include "lts_field_internal.h"

typedef struct {
  int low;
  float share;
} lts_place;

static inline lts_place lts_place_at(const lts_field_model *m, float u) {
  const float last = (float)(m->n_bin - 1);
  float place = (u - m->first_bin) / m->bin_width;
  place = place > 0.0f ? (place < last ? place : last) : 0.0f;
  lts_place at = {(int)place, 0.0f};
  if (at.low > m->n_bin - 2) at.low = m->n_bin - 2;
  at.share = place - (float)at.low;
  return at;
}

static inline float lts_between(const float *channel, lts_place at) {
  return (1.0f - at.share) * channel[at.low] + at.share * channel[at.low + 1];
}

static inline float lts_relu(float x) { return x < 0.0f ? 0.0f : x; }

/* Columns of own inputs that are a tanh, and those that are an exp, which follow from it:
 * exp(-x) = (1 - t) / (1 + t), t = tanh(x / 2). Their arguments are kept side by side. */
#define LTS_MOST_CURVED 48
typedef struct {
  int n, column[LTS_MOST_CURVED];
  float value[LTS_MOST_CURVED][LTS_FIELD_ROWS];
} lts_curves;

static inline void lts_finish(const lts_field *soil, lts_curves *c, int n, int is_exp, float *out,
                              int ld) {
  for (int j = 0; j < c->n; ++j) {
    float *t = c->value[j];
    for (int row = n; row < LTS_PADDED(n); ++row) t[row] = 0.0f;
    soil->run->tanh_of(t, LTS_PADDED(n), t);
    for (int row = 0; row < LTS_PADDED(n) && is_exp; ++row) t[row] = (1.0f - t[row]) / (1.0f + t[row]);
    for (int row = 0; row < n; ++row) out[row * ld + c->column[j]] = t[row];
  }
}

/* Places in whole bins and shares of the next one: added to those of a particle. */
#define LTS_MOST_PLACES 32
typedef struct {
  int n, bin[LTS_MOST_PLACES];
  float share[LTS_MOST_PLACES];
} lts_offsets;

static inline void lts_split(const lts_field_model *m, const float *places, int n, lts_offsets *out) {
  out->n = n;
  for (int j = 0; j < n; ++j) {
    const double bins = (double)places[j] / m->bin, low = floor(bins + 1e-5);
    out->bin[j] = (int)low;
    out->share[j] = bins - low < 1e-5 ? 0.0f : (float)(bins - low);
  }
}

static inline lts_place lts_moved(lts_place here, const lts_offsets *o, int j) {
  const float share = here.share + o->share[j];
  const int more = share >= 1.0f;
  const lts_place at = {here.low + o->bin[j] + more, share - (float)more};
  return at;
}

#endif
