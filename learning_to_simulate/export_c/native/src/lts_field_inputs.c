/* What the networks of a blade see and say: twin of `inputs.py`, in its order and its float32; and how a
 * blade pushes soil out. */
#include "lts_field_places.h"

/* Names of a frame's scalars behind its memories. */
typedef struct {
  float tip, height, lean, area, foremost, half_width, end;
} named;
static named named_of(const lts_field *soil) {
  const float *s = soil->scalars, *tail = s + 6 + 3 * soil->model->n_scale;
  const named n = {s[LTS_TIP], s[LTS_HEIGHT], s[LTS_LEAN], tail[0], tail[1], tail[2], tail[3]};
  return n;
}

static float contact_of(const lts_field *soil) {
  const lts_field_model *m = soil->model;
  const named s = named_of(soil);
  float surface = -HUGE_VALF;
  for (int k = 0; k < m->n_contact; ++k) {
    const lts_place at = lts_place_at(m, s.tip + m->contact[k]);
    surface = fmaxf(surface, lts_between(soil->bins[LTS_SURFACE], at));
  }
  const float heap = m->heap_height * sqrtf(lts_relu(s.area));
  const float clearance = s.height - (float)m->blade_radius - surface;
  const float share = (heap + m->contact_above - clearance) / m->contact_ramp;
  return share < 0.0f ? 0.0f : share > 1.0f ? 1.0f : share;
}

/* How the tool stands. */
static float *of_tool(const lts_field *soil, float *x) {
  const named s = named_of(soil);
  *x++ = s.height / 0.05f;
  *x++ = lts_relu(s.height) / 0.03f;
  *x++ = s.lean;
  *x++ = s.area / 0.01f;
  *x++ = sqrtf(lts_relu(s.area) + 1e-6f) / 0.1f;
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

static void force_inputs(const lts_field *soil, float *x) {
  const lts_field_model *m = soil->model;
  const named s = named_of(soil);
  const int n = m->n_edge;
  float *cut = of_motion(soil, of_tool(soil, x)), *surface = cut + n, *low = surface + n, *since = low + n;
  float depth = 0.0f;
  for (int k = 0; k < n; ++k) {
    const lts_place at = lts_place_at(m, s.tip + m->edge[k]);
    const float c = lts_between(soil->bins[LTS_CUT], at), top = lts_between(soil->bins[LTS_SURFACE], at);
    cut[k] = c / 0.03f;
    surface[k] = (top - s.height) / 0.05f;
    low[k] = tanhf((top - c - s.height) / 0.02f);
    since[k] = expf(-lts_between(soil->bins[LTS_SINCE], at) / m->recent);
    if (k == n / 2) depth = lts_relu(top - s.height) / 0.05f;
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

static void shared_inputs(const lts_field *soil, float *x) { of_tool(soil, x); }

static void own_inputs(const lts_field *soil, const int32_t *which, int n, float *out, int ld) {
  const lts_field_model *m = soil->model;
  const named s = named_of(soil);
  const float *cuts = soil->bins[LTS_CUT], *surfaces = soil->bins[LTS_SURFACE];
  lts_curves tanhs, exps;
  tanhs.n = exps.n = 0;
  lts_offsets around, since;
  lts_split(m, m->around, m->n_around, &around);
  lts_split(m, m->since, m->n_since, &since);
  for (int row = 0; row < n; ++row) {
    const int i = which[row];
    const float u = soil->u[i], y = soil->y[i], beside = fabsf(soil->z[i]);
    const float behind = s.tip - u, foremost = s.foremost - u;
    const lts_place here = {soil->low[i], soil->share[i]};
    const float cut = lts_between(cuts, here), surface = lts_between(surfaces, here);
    const float before = lts_between(soil->bins[LTS_AREA_BEFORE], here), above = y - surface + cut;
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
    const float past_end = beside - s.half_width;
    TANH(past_end / 0.008f);
    EXP_MINUS((past_end / 0.02f) * (past_end / 0.02f));
    TANH(above / 0.004f);
    EXP_MINUS((above / 0.012f) * (above / 0.012f));
    for (int j = 0; j < around.n; ++j) {
      const lts_place at = lts_moved(here, &around, j);
      x[k + j] = lts_between(cuts, at) / 0.03f;
      x[k + around.n + j] = (lts_between(surfaces, at) - surface) / 0.03f;
    }
    k += 2 * around.n;
    for (int j = 0; j < since.n; ++j) {
      EXP_MINUS(lts_between(soil->bins[LTS_SINCE], lts_moved(here, &since, j)) / m->recent);
    }
    tanhs.n = t;
    exps.n = e;
#undef TANH
#undef EXP_MINUS
  }
  lts_finish(soil, &tanhs, n, 0, out, ld);
  lts_finish(soil, &exps, n, 1, out, ld);
}

static int load_share(const lts_field *soil, float share[3]) {
  share[0] = contact_of(soil) * (2.0f * named_of(soil).half_width / soil->model->full_width);
  return share[0] > 0.0f;
}

static void load_of(const lts_field_model *m, const float *out, const float share[3],
                    double load[LTS_MOST_LOADS]) {
  const float most = m->gain_limit, gain = expf(fminf(fmaxf(out[3], -most), most));
  const float scale[3] = {m->force, m->force, m->torque};
  for (int k = 0; k < 3; ++k) load[k] = out[k] * gain * share[0] * scale[k];
  load[3] = 0.0;
}

/* Twin of `soil_physics.inside`. */
static void push_out(const lts_field *soil, double point[3]) {
  const lts_field_model *m = soil->model;
  const lts_field_head *h = soil->head;
  const double *axis = soil->axis;
  const double rel[2] = {point[0] - h->position[0], point[1] - h->position[1]};
  double along = (rel[0] * axis[0] + rel[1] * axis[1]) / (m->length * m->length);
  along = along < 0.0 ? 0.0 : along > 1.0 ? 1.0 : along;
  const double away[2] = {rel[0] - along * axis[0], rel[1] - along * axis[1]};
  const double square = away[0] * away[0] + away[1] * away[1];
  const double beside = 0.5 * h->ground.width - fabs(point[2]);
  if (!(square < m->blade_radius * m->blade_radius && beside > 0.0)) return;
  const double distance = sqrt(square), in_plane = m->blade_radius - distance;
  if (in_plane > beside) {
    point[2] += point[2] < 0.0 ? -beside : beside;
  } else if (distance > 1e-12) {
    point[0] += in_plane * away[0] / distance;
    point[1] += in_plane * away[1] / distance;
  } else { /* on the segment itself there is no nearest side: out to the front */
    point[0] += in_plane * axis[1] / m->length;
    point[1] -= in_plane * axis[0] / m->length;
  }
}

const lts_field_tool lts_field_blade = {4,          lts_field_see, lts_field_see_reach, force_inputs,
                                        shared_inputs, own_inputs,    load_share,          load_of,
                                        push_out};
