/* What differs between blade and wheel beside their paths: what outputs of the load mean, twin of (14), (19) of
 * `network.py`, and how soil is pushed out, twin of `Blade.inside` and `Wheel.inside`. */
#include <math.h>

#include "lts_field_internal.h"

static float relu(float x) { return x < 0.0f ? 0.0f : x; }

/* A blade's area and half width stand behind its memories, see `blade.SCALARS`. */
static const float *blade_tail(const lts_field *soil) { return soil->scalars + 6 + 3 * soil->model->n_scale; }

/* (13) of `blade.py`: the share of contact, 0 in the air. */
static float contact_of(const lts_field *soil) {
  const lts_field_model *m = soil->model;
  const float *s = soil->scalars;
  float surface = -HUGE_VALF;
  for (int k = 0; k < m->n_contact; ++k) {
    surface = fmaxf(surface, lts_field_channel_at(soil, LTS_SURFACE, s[LTS_TIP] + m->contact[k]));
  }
  const float heap = m->heap_height * sqrtf(relu(blade_tail(soil)[0]));
  const float clearance = s[LTS_HEIGHT] - (float)m->blade_radius - surface;
  const float share = (heap + m->contact_above - clearance) / m->contact_ramp;
  return share < 0.0f ? 0.0f : share > 1.0f ? 1.0f : share;
}

static int blade_share(const lts_field *soil, float share[3]) {
  share[0] = contact_of(soil) * (2.0f * blade_tail(soil)[2] / soil->model->full_width);
  return share[0] > 0.0f;
}

static void blade_load(const lts_field_model *m, const float *out, const float share[3],
                       double load[LTS_MOST_LOADS]) {
  const float most = m->gain_limit, gain = expf(fminf(fmaxf(out[3], -most), most));
  const float scale[3] = {m->force, m->force, m->torque};
  for (int k = 0; k < 3; ++k) load[k] = out[k] * gain * share[0] * scale[k];
  load[3] = 0.0;
}

/* Out of a body by the nearer of rim and side: `in_plane` deep, `away` the vector from its middle line, which
 * is `distance` long; `otherwise` the direction of a point on that line. */
static void push(double point[3], double in_plane, double beside, const double away[2], double distance,
                 const double otherwise[2]) {
  if (in_plane > beside) {
    point[2] += point[2] < 0.0 ? -beside : beside;
    return;
  }
  const int has_side = distance > 1e-12;
  for (int k = 0; k < 2; ++k) point[k] += in_plane * (has_side ? away[k] / distance : otherwise[k]);
}

static void blade_push_out(const lts_field *soil, double point[3]) {
  const lts_field_model *m = soil->model;
  const lts_field_head *h = soil->head;
  const double *axis = soil->axis;
  const double rel[2] = {point[0] - h->position[0], point[1] - h->position[1]};
  double along = (rel[0] * axis[0] + rel[1] * axis[1]) / (m->length * m->length);
  along = along < 0.0 ? 0.0 : along > 1.0 ? 1.0 : along;
  const double away[2] = {rel[0] - along * axis[0], rel[1] - along * axis[1]};
  const double square = away[0] * away[0] + away[1] * away[1];
  const double beside = 0.5 * h->ground.width - fabs(point[2]);
  const double front[2] = {axis[1] / m->length, -axis[0] / m->length};
  if (!(square < m->blade_radius * m->blade_radius && beside > 0.0)) return;
  push(point, m->blade_radius - sqrt(square), beside, away, sqrt(square), front);
}

/* Names of a wheel's scalars behind its rates, see `wheel.SCALARS`. */
enum { LOAD_OF_FRAME = 5, RADIUS = 8, SUNK = 12, STIRRED = 16 };

static int wheel_share(const lts_field *soil, float share[3]) {
  const float *s = soil->scalars + 4 + 2 * soil->model->n_scale;
  share[0] = s[LOAD_OF_FRAME];
  share[1] = s[LOAD_OF_FRAME] * s[RADIUS];
  share[2] = s[STIRRED] * (relu(s[SUNK]) + soil->model->least_sunk);
  return 1;
}

static void wheel_load(const lts_field_model *m, const float *out, const float share[3],
                       double load[LTS_MOST_LOADS]) {
  load[0] = share[0] * out[0];
  load[1] = share[0] * (1.0f + m->vertical * out[1]);
  load[2] = share[1] * out[2];
  load[3] = share[2] * out[3];
}

static void wheel_push_out(const lts_field *soil, double point[3]) {
  const lts_field_head *h = soil->head;
  const double beside = 0.5 * h->drive.width - fabs(point[2]);
  const double away[2] = {point[0] - h->position[0], point[1] - h->position[1]};
  const double distance = hypot(away[0], away[1]), in_plane = h->drive.radius - distance;
  const double down[2] = {0.0, -1.0};
  if (in_plane > 0.0 && beside > 0.0) push(point, in_plane, beside, away, distance, down);
}

const lts_field_tool lts_field_blade = {4,           lts_field_see, lts_field_see_reach,
                                        blade_share, blade_load,    blade_push_out};
const lts_field_tool lts_field_wheel = {7,           lts_field_wheel_see, lts_field_wheel_see_reach,
                                        wheel_share, wheel_load,          wheel_push_out};
