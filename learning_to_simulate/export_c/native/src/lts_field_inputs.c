/* What the networks see: twin of `inputs.py`, in its order and its float32. */
#include <math.h>

#include "lts_field_internal.h"

lts_place lts_field_place(const lts_field_model *m, float u) {
  const float last = (float)(m->n_bin - 1);
  float place = (u - m->first_bin) / m->bin_width;
  place = place > 0.0f ? (place < last ? place : last) : 0.0f;
  lts_place at = {(int)place, 0.0f};
  if (at.low > m->n_bin - 2) at.low = m->n_bin - 2;
  at.share = place - (float)at.low;
  return at;
}

static inline float between(const float *channel, lts_place at) {
  return (1.0f - at.share) * channel[at.low] + at.share * channel[at.low + 1];
}

static float relu(float x) { return x < 0.0f ? 0.0f : x; }

/* Names of a frame's scalars behind its memories. */
typedef struct {
  float tip, height, lean, area, foremost, half_width, end;
} named;
static named named_of(const lts_field *soil) {
  const float *s = soil->scalars, *tail = s + 6 + 3 * soil->model->n_scale;
  const named n = {s[LTS_TIP], s[LTS_HEIGHT], s[LTS_LEAN], tail[0], tail[1], tail[2], tail[3]};
  return n;
}

float lts_field_contact(const lts_field *soil) {
  const lts_field_model *m = soil->model;
  const named s = named_of(soil);
  float surface = -HUGE_VALF;
  for (int k = 0; k < m->n_contact; ++k) {
    const lts_place at = lts_field_place(m, s.tip + m->contact[k]);
    surface = fmaxf(surface, between(soil->bins[LTS_SURFACE], at));
  }
  const float heap = m->heap_height * sqrtf(relu(s.area));
  const float clearance = s.height - (float)m->blade_radius - surface;
  const float share = (heap + m->contact_above - clearance) / m->contact_ramp;
  return share < 0.0f ? 0.0f : share > 1.0f ? 1.0f : share;
}

/* How the tool stands. */
static float *of_tool(const lts_field *soil, float *x) {
  const named s = named_of(soil);
  *x++ = s.height / 0.05f;
  *x++ = relu(s.height) / 0.03f;
  *x++ = s.lean;
  *x++ = s.area / 0.01f;
  *x++ = sqrtf(relu(s.area) + 1e-6f) / 0.1f;
  *x++ = (s.foremost - s.tip) / 0.1f;
  *x++ = s.half_width / 0.2f;
  *x++ = s.end - s.tip;
  return x;
}

/* How it moves. */
static float *of_motion(const lts_field *soil, float *x) {
  const float *rate = soil->scalars + LTS_SPEED;
  *x++ = tanhf(rate[0] / 0.02f);
  *x++ = tanhf(rate[1] / 0.02f);
  for (int i = 0; i < 3 * (1 + soil->model->n_scale); ++i) {
    *x++ = rate[i] / (i % 3 == 2 ? 1.0f : 0.1f);
  }
  return x;
}

void lts_field_force_inputs(const lts_field *soil, float *x) {
  const lts_field_model *m = soil->model;
  const named s = named_of(soil);
  const int n = m->n_edge;
  float *cut = of_motion(soil, of_tool(soil, x)), *surface = cut + n, *low = surface + n, *since = low + n;
  float depth = 0.0f;
  for (int k = 0; k < n; ++k) {
    const lts_place at = lts_field_place(m, s.tip + m->edge[k]);
    const float c = between(soil->bins[LTS_CUT], at), top = between(soil->bins[LTS_SURFACE], at);
    cut[k] = c / 0.03f;
    surface[k] = (top - s.height) / 0.05f;
    low[k] = tanhf((top - c - s.height) / 0.02f);
    since[k] = expf(-between(soil->bins[LTS_SINCE], at) / m->recent);
    if (k == n / 2) depth = relu(top - s.height) / 0.05f;
  }
  const float *speed = soil->scalars + LTS_SPEED;
  const float size = sqrtf(speed[0] * speed[0] + speed[1] * speed[1] + 1e-8f);
  x = since + n;
  *x++ = depth;
  *x++ = depth * depth;
  *x++ = speed[0] / size;
  *x++ = speed[1] / size;
  *x++ = logf(size / 0.03f);
  *x++ = size / 0.1f;
  *x = tanhf((s.end - s.tip) / 0.1f);
}

void lts_field_shared_inputs(const lts_field *soil, float *x) { of_tool(soil, x); }

/* Columns of `lts_field_own_inputs` that are a tanh, and those that are an exp, which follow from it:
 * exp(-x) = (1 - t) / (1 + t), t = tanh(x / 2). Their arguments are kept side by side. */
#define MOST_CURVED 48
typedef struct {
  int n, column[MOST_CURVED];
  float value[MOST_CURVED][LTS_FIELD_ROWS];
} curves;

static void finish(const lts_field *soil, curves *c, int n, int is_exp, float *out, int ld) {
  for (int j = 0; j < c->n; ++j) {
    float *t = c->value[j];
    for (int row = n; row < LTS_PADDED(n); ++row) t[row] = 0.0f;
    soil->run->tanh_of(t, LTS_PADDED(n), t);
    for (int row = 0; row < LTS_PADDED(n) && is_exp; ++row) t[row] = (1.0f - t[row]) / (1.0f + t[row]);
    for (int row = 0; row < n; ++row) out[row * ld + c->column[j]] = t[row];
  }
}

/* Places in whole bins and shares of the next one: added to those of a particle. */
#define MOST_PLACES 32
typedef struct {
  int n, bin[MOST_PLACES];
  float share[MOST_PLACES];
} offsets;

static void split(const lts_field_model *m, const float *places, int n, offsets *out) {
  out->n = n;
  for (int j = 0; j < n; ++j) {
    const double bins = (double)places[j] / m->bin, low = floor(bins + 1e-5);
    out->bin[j] = (int)low;
    out->share[j] = bins - low < 1e-5 ? 0.0f : (float)(bins - low);
  }
}

static inline lts_place moved(lts_place here, const offsets *o, int j) {
  const float share = here.share + o->share[j];
  const int more = share >= 1.0f;
  const lts_place at = {here.low + o->bin[j] + more, share - (float)more};
  return at;
}

void lts_field_own_inputs(const lts_field *soil, const int32_t *which, int n, float *out, int ld) {
  const lts_field_model *m = soil->model;
  const named s = named_of(soil);
  const float *cuts = soil->bins[LTS_CUT], *surfaces = soil->bins[LTS_SURFACE];
  curves tanhs, exps;
  offsets around, since;
  split(m, m->around, m->n_around, &around);
  split(m, m->since, m->n_since, &since);
  for (int row = 0; row < n; ++row) {
    const int i = which[row];
    const float u = soil->u[i], y = soil->y[i], beside = fabsf(soil->z[i]);
    const float behind = s.tip - u, foremost = s.foremost - u;
    const lts_place here = {soil->low[i], soil->share[i]};
    const float cut = between(cuts, here), surface = between(surfaces, here);
    const float before = between(soil->bins[LTS_AREA_BEFORE], here), above = y - surface + cut;
    float *x = out + row * ld;
    int k = 0, t = 0, e = 0;
#define TANH(argument) (tanhs.column[t] = k++, tanhs.value[t++][row] = (argument))
#define EXP_MINUS(argument) (exps.column[e] = k++, exps.value[e++][row] = 0.5f * (argument))
    x[k++] = behind / 0.15f;
    TANH(behind / 0.03f);
    for (int b = 0; b < m->n_bump; ++b) {
      const float away = (behind - m->bumps[b]) / m->bump_width;
      EXP_MINUS(away * away);
    }
    x[k++] = (y - surface) / 0.05f;
    x[k++] = (y - s.height) / 0.05f;
    TANH((y - s.height) / 0.02f);
    x[k++] = beside / 0.15f;
    TANH((beside - s.half_width) / 0.03f);
    TANH((beside - s.half_width) / 0.1f);
    x[k++] = above / 0.05f;
    TANH(above / 0.01f);
    x[k++] = foremost / 0.15f;
    TANH(foremost / 0.03f);
    x[k++] = before / 0.01f;
    x[k++] = sqrtf(before + 1e-6f) / 0.1f;
    x[k++] = s.end - u;
    for (int j = 0; j < around.n; ++j) {
      const lts_place at = moved(here, &around, j);
      x[k + j] = between(cuts, at) / 0.03f;
      x[k + around.n + j] = (between(surfaces, at) - surface) / 0.03f;
    }
    k += 2 * around.n;
    for (int j = 0; j < since.n; ++j) {
      EXP_MINUS(between(soil->bins[LTS_SINCE], moved(here, &since, j)) / m->recent);
    }
    tanhs.n = t;
    exps.n = e;
#undef TANH
#undef EXP_MINUS
  }
  finish(soil, &tanhs, n, 0, out, ld);
  finish(soil, &exps, n, 1, out, ld);
}
