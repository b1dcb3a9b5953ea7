/* The surface and particles: how far they have risen, and moved. Twin of `_places`, `rise` and `displacement` of
 * `soil_field/network.py`. */
#include <math.h>
#include <string.h>

#include "lts_soil_internal.h"

static float clip(float x, float low, float high) { return x > low ? (x < high ? x : high) : low; }

/* One more place, with what lies there; 0 where it has not moved, to the last bit: (13), (15). */
static int take(const lts_soil *soil, const lts_passage *p, int is_surface, const double place[3], size_t which,
                lts_places *at) {
  const lts_soil_model *m = soil->model;
  const int n_strip = p->s.n_strip, i = at->n;
  const float u = (float)place[0], y = (float)place[1], z = (float)place[2];
  const float *s = soil->scalars[0];
  const float across = clip((s[LTS_SOIL_OWN] + m->beside - fabsf(z)) / m->beside_ramp, 0.0f, 1.0f);
  const float stirred = clip(s[LTS_SOIL_WAY] / m->stir, 0.0f, 1.0f);
  if (!(across * stirred > 0.0f)) return 0;
  double share;
  const int strip = lts_soil_strip_at(soil, n_strip, place[2], &share);
  const lts_spot spot = lts_soil_spot(soil, n_strip, strip, (float)share, u);
  const float influence = lts_soil_channel(soil, LTS_SOIL_INFLUENCE, &spot);
  float gate = influence * stirred * across;
  if (!(gate > 0.0f)) return 0;
  if (!is_surface) {
    const float disturbed = lts_soil_channel(soil, LTS_SOIL_DISTURBED, &spot);
    const float deep = disturbed + m->below - (lts_soil_channel(soil, LTS_SOIL_SURFACE, &spot) - y);
    gate *= clip(deep / m->below_ramp, 0.0f, 1.0f);
    if (!(gate > 0.0f)) return 0;
  }
  for (int k = 0; k < LTS_SOIL_CHANNELS; ++k) at->here[k][i] = lts_soil_channel(soil, k, &spot);
  /* Farther from and nearer to the middle. */
  const double sign = place[2] < 0.0 ? -1.0 : 1.0, away[3] = {0.0, m->neighbour, -m->neighbour};
  for (int k = 0; k < 3; ++k) {
    at->strip[k][i] = lts_soil_strip_at(soil, n_strip, place[2] + away[k] * sign, &share);
    at->share[k][i] = (float)share;
  }
  const float *low = soil->scalars[strip], *high = soil->scalars[strip + (n_strip > 1)];
  int of_strip[LTS_SOIL_OF_STRIP];
  lts_soil_scalars_of_strip(m, of_strip);
  for (int k = 0; k < LTS_SOIL_OF_STRIP; ++k) {
    at->of_strip[k][i] = low[of_strip[k]] + at->share[0][i] * (high[of_strip[k]] - low[of_strip[k]]);
  }
  at->u[i] = u;
  at->y[i] = y;
  at->z[i] = z;
  at->gate[i] = gate;
  at->which[i] = which;
  ++at->n;
  return 1;
}

/* The terrain beside, farther from and nearer to the middle; nothing where they change over. */
static void see_beside(const lts_soil *soil, const lts_places *at, int n_strip, float *out, int ld) {
  const lts_soil_model *m = soil->model;
  if (n_strip == 1) { /* nothing differs */
    for (int i = 0; i < at->n; ++i) out[i * ld] = out[i * ld + 1] = 0.0f;
    return;
  }
  for (int i = 0; i < at->n; ++i) {
    const float fade = clip(fabsf(at->z[i]) / m->across_ramp, 0.0f, 1.0f);
    for (int k = 1; k < 3; ++k) {
      const float there = lts_soil_channel_at(soil, LTS_SOIL_SURFACE, n_strip, at->strip[k][i],
                                              at->share[k][i], at->u[i]);
      out[i * ld + k - 1] = fade * (there - at->here[LTS_SOIL_SURFACE][i]) / m->length;
    }
  }
}

/* What all places see of the tool; on one strip that is the same for all of a frame. */
static void see_tool(const lts_soil *soil, lts_places *at, int n_strip, float *out, int ld) {
  const int n = at->n;
  float base[LTS_SOIL_LANES];
  if (at->knows_tool) return;
  if (n_strip == 1) at->n = 1;
  for (int i = 0; i < at->n; ++i) base[i] = soil->scalars[0][LTS_SOIL_TIP];
  lts_soil_inputs(soil, &soil->model->tool, at, n_strip, base, NULL, out, ld);
  at->n = n;
  if (n_strip > 1) return;
  at->knows_tool = 1;
  for (int i = 1; i < LTS_SOIL_LANES; ++i) {
    memcpy(out + i * ld, out, (size_t)soil->model->tool.n_row * sizeof *out);
  }
}

/* Sends places through their network and empties them. */
static void answer(const lts_soil *soil, int n_strip, int is_surface, lts_places *at, float *out) {
  const lts_soil_model *m = soil->model;
  const lts_soil_network *net = is_surface ? &m->surface : &m->soil;
  const int n_out = is_surface ? 1 : 3, ld = LTS_PADDED(net->layers[0].rows);
  float sums[LTS_SOIL_LANES][3] = {{0.0f}};
  float *inputs = soil->inputs;
  lts_soil_inputs(soil, &m->here, at, n_strip, at->u, NULL, inputs, ld);
  inputs += m->here.n_row;
  if (!is_surface) {
    lts_soil_inputs(soil, &m->particle, at, n_strip, at->u, NULL, inputs, ld);
    inputs += m->particle.n_row;
  }
  see_beside(soil, at, n_strip, inputs, ld);
  see_tool(soil, at, n_strip, inputs + 2, ld);
  for (int member = 0; member < soil->members; ++member) {
    lts_soil_run(soil, net, member, soil->inputs, ld, at->n);
    for (int i = 0; i < at->n; ++i) {
      for (int k = 0; k < n_out; ++k) sums[i][k] += soil->out[i * LTS_PANEL + k];
    }
  }
  for (int i = 0; i < at->n; ++i) {
    const float size = m->length * at->gate[i] / (float)soil->members;
    const float odd = clip(at->z[i] / m->across_ramp, -1.0f, 1.0f);
    for (int k = 0; k < n_out; ++k) {
      out[(size_t)n_out * at->which[i] + (size_t)k] = size * sums[i][k] * (k == 2 ? odd : 1.0f);
    }
  }
  at->n = 0;
}

void lts_soil_find(lts_soil *soil, const lts_passage *p, int is_surface, size_t n,
                   void (*place)(const void *, size_t, double[3]), const void *of, float *out) {
  lts_places *at = soil->places;
  lts_soil_make_frame(soil, p, 1);
  if (!n) return;
  memset(out, 0, n * (is_surface ? 1 : 3) * sizeof *out);
  at->n = 0;
  at->knows_tool = 0;
  for (size_t i = 0; i < n; ++i) {
    double local[3];
    place(of, i, local);
    if (take(soil, p, is_surface, local, i, at) && at->n == LTS_SOIL_LANES) {
      answer(soil, p->s.n_strip, is_surface, at, out);
    }
  }
  if (at->n) answer(soil, p->s.n_strip, is_surface, at, out);
}
