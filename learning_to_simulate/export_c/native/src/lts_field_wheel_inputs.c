/* What the networks of a wheel see and say: twin of `wheel_inputs.py`, in its order and its float32; and
 * how a wheel pushes soil out. */
#include "lts_field_places.h"

/* A frame's scalars behind its rates, in the order of `wheel_path.SCALARS`, but the room, which is only
 * judged. */
typedef struct {
  float tip, rolled;
  float travelled, slipped, foremost, rearmost, load, frame_load, peak_load, first_load;
  float radius, half_width, gravity, friction, sunk, contact, end, stirred, height;
} named;
static named named_of(const lts_field *soil) {
  const float *s = soil->scalars, *t = s + 4 + 2 * soil->model->n_scale;
  const named n = {s[0], s[1], t[0],  t[1],  t[2],  t[3],  t[4],  t[5],  t[6], t[7],
                   t[8], t[9], t[10], t[11], t[12], t[13], t[14], t[16], t[17]};
  return n;
}

/* What wheel it is, on what soil, and how far it has gone. */
static float *of_drive(const lts_field *soil, float *x) {
  const lts_field_model *m = soil->model;
  const named s = named_of(soil);
  const float weight = m->density * s.gravity * s.radius * s.radius * 2.0f * s.half_width;
  const float contact = s.contact;
  *x++ = logf(s.first_load / weight) / 2.0f;
  *x++ = (s.friction - 0.75f) / 0.15f;
  *x++ = logf(s.radius / 0.075f);
  *x++ = logf(fmaxf(s.sunk, m->least_sunk) / s.radius);
  *x++ = s.load / s.first_load - 1.0f;
  *x++ = s.peak_load / s.first_load - 1.0f;
  *x++ = s.tip / contact / 3.0f;
  *x++ = tanhf(s.tip / contact);
  *x++ = tanhf(fabsf(s.tip) / (0.3f * contact));
  *x++ = s.rolled / contact / 3.0f;
  *x++ = tanhf(s.rolled / contact);
  *x++ = log1pf(s.slipped / m->sheared) / 2.0f;
  *x++ = log1pf(s.slipped / contact);
  *x++ = log1pf(s.travelled / contact);
  *x++ = (s.foremost - s.tip) / contact;
  *x++ = (s.tip - s.rearmost) / contact;
  *x++ = tanhf(s.foremost / contact);
  *x++ = tanhf(s.rearmost / contact);
  return x;
}

/* How it slips and has slipped. */
static float *of_rates(const lts_field *soil, float *x) {
  for (int i = 0; i <= soil->model->n_scale; ++i) {
    const float speed = soil->scalars[2 + 2 * i], rim = soil->scalars[3 + 2 * i];
    const float size = sqrtf(speed * speed + rim * rim + 1e-6f);
    *x++ = (rim - speed) / size;
    *x++ = rim / size;
    *x++ = speed / size;
  }
  return x;
}

static void force_inputs(const lts_field *soil, float *x) {
  const lts_field_model *m = soil->model;
  const named s = named_of(soil);
  const int n = m->n_edge;
  float *since = of_rates(soil, of_drive(soil, x)), *slid = since + n, *shear = slid + n;
  float *peak = shear + n;
  for (int k = 0; k < n; ++k) {
    const lts_place at = lts_place_at(m, s.tip + s.contact * m->edge[k]);
    since[k] = expf(-lts_between(soil->bins[LTS_SINCE], at) / m->recent);
    slid[k] = log1pf(lts_between(soil->bins[LTS_SLID], at) / m->sheared) / 2.0f;
    shear[k] = tanhf(lts_between(soil->bins[LTS_SHEAR], at) / m->sheared);
    peak[k] = lts_between(soil->bins[LTS_PEAK], at) / s.first_load;
  }
  peak[n] = tanhf((s.end - s.tip) / 0.1f);
}

static void shared_inputs(const lts_field *soil, float *x) {
  const named s = named_of(soil);
  *of_drive(soil, x) = (s.height - s.radius) / 0.02f;
}

static void own_inputs(const lts_field *soil, const int32_t *which, int n, float *out, int ld) {
  const lts_field_model *m = soil->model;
  const named s = named_of(soil);
  const float *cuts = soil->bins[LTS_CUT], *surfaces = soil->bins[LTS_SURFACE];
  lts_curves tanhs, exps;
  tanhs.n = exps.n = 0;
  lts_offsets around, slip;
  lts_split(m, m->around, m->n_around, &around);
  lts_split(m, m->since, m->n_since, &slip);
  for (int row = 0; row < n; ++row) {
    const int i = which[row];
    const float u = soil->u[i], y = soil->y[i], beside = fabsf(soil->z[i]), behind = s.tip - u;
    const lts_place here = {soil->low[i], soil->share[i]};
    const float surface = lts_between(surfaces, here), above = y - surface + lts_between(cuts, here);
    /* How far the particle is from the rim, now and when the wheel was set down. */
    const float up = y - s.height, up_first = y - s.radius + s.sunk;
    const float from_rim = sqrtf(behind * behind + up * up + 1e-8f) - s.radius;
    const float at_first = sqrtf(u * u + up_first * up_first + 1e-8f) - s.radius;
    float *x = out + row * ld;
    int k = 0, t = 0, e = 0;
#define TANH(argument) (tanhs.column[t] = k++, tanhs.value[t++][row] = (argument))
#define EXP_MINUS(argument) (exps.column[e] = k++, exps.value[e++][row] = 0.5f * (argument))
    x[k++] = behind / 0.1f;
    TANH(behind / 0.015f);
    TANH(behind / s.contact);
    for (int c = -1; c <= 1; ++c) {
      const float away = behind / s.contact - (float)c;
      EXP_MINUS(away * away);
    }
    x[k++] = u / 0.1f;
    TANH(u / s.contact);
    TANH((s.foremost - u) / s.contact);
    TANH((s.rearmost - u) / s.contact);
    x[k++] = (y - surface) / 0.03f;
    TANH((y - surface) / 0.01f);
    x[k++] = (y - s.height + s.radius) / 0.03f;
    x[k++] = from_rim / 0.03f;
    TANH(from_rim / 0.01f);
    TANH(at_first / 0.01f);
    x[k++] = beside / 0.06f;
    TANH((beside - s.half_width) / 0.015f);
    TANH((beside - s.half_width) / 0.04f);
    x[k++] = above / 0.02f;
    TANH(above / 0.005f);
    x[k++] = s.end - u;
    for (int j = 0; j < around.n; ++j) {
      const lts_place at = lts_moved(here, &around, j);
      const float cut = lts_between(cuts, at);
      x[k + j] = cut / 0.02f;
      x[k + around.n + j] = (cut - lts_between(soil->bins[LTS_FIRST_CUT], at)) / 0.01f;
      x[k + 2 * around.n + j] = (lts_between(surfaces, at) - surface) / 0.02f;
    }
    k += 3 * around.n;
    for (int j = 0; j < slip.n; ++j) {
      EXP_MINUS(lts_between(soil->bins[LTS_SINCE], lts_moved(here, &slip, j)) / m->recent);
    }
    for (int j = 0; j < slip.n; ++j) {
      const float slid = lts_between(soil->bins[LTS_SLID], lts_moved(here, &slip, j));
      x[k++] = log1pf(slid / m->sheared);
    }
    for (int j = 0; j < slip.n; ++j) {
      const lts_place at = lts_moved(here, &slip, j);
      const float shear = lts_between(soil->bins[LTS_SHEAR], at);
      TANH(shear / m->sheared);
      x[k - 1 + slip.n] = shear / 0.03f;
      x[k - 1 + 2 * slip.n] = lts_between(soil->bins[LTS_PEAK], at) / s.first_load;
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
  const named s = named_of(soil);
  share[0] = s.frame_load;
  share[1] = s.frame_load * s.radius;
  share[2] = s.stirred * (lts_relu(s.sunk) + soil->model->least_sunk);
  return 1;
}

/* The wheel bears its load. */
static void load_of(const lts_field_model *m, const float *out, const float share[3],
                    double load[LTS_MOST_LOADS]) {
  load[0] = share[0] * out[0];
  load[1] = share[0] * (1.0f + m->vertical * out[1]);
  load[2] = share[1] * out[2];
  load[3] = share[2] * out[3];
}

/* Twin of `soil_physics.inside_wheel`. */
static void push_out(const lts_field *soil, double point[3]) {
  const lts_field_head *h = soil->head;
  const double radius = h->drive.radius, beside = 0.5 * h->drive.width - fabs(point[2]);
  const double away[2] = {point[0] - h->position[0], point[1] - h->position[1]};
  const double distance = hypot(away[0], away[1]), in_plane = radius - distance;
  if (!(in_plane > 0.0 && beside > 0.0)) return;
  if (in_plane > beside) {
    point[2] += point[2] < 0.0 ? -beside : beside;
  } else if (distance > 1e-12) {
    point[0] += in_plane * away[0] / distance;
    point[1] += in_plane * away[1] / distance;
  } else { /* on the axle there is no nearest side: down */
    point[1] -= in_plane;
  }
}

const lts_field_tool lts_field_wheel = {
    7,          lts_field_wheel_see, lts_field_wheel_see_reach, force_inputs, shared_inputs,
    own_inputs, load_share,          load_of,                   push_out};
