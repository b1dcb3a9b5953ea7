/* What a blade has swept so far: twin of `tool/swept.py` and `tool/blade.py`, for one tool; and what a
 * wheel shares with it. */
#include <math.h>
#include <string.h>

#include "lts_field_internal.h"

/* Lowest height at `u` of a circle that goes straight from `before` to `after`; infinite where it has
 * not been: the lower envelope of both end circles and, between its ends, of their tangent. */
double lts_field_underside(double u, const double before[2], const double after[2], double radius) {
  double height = HUGE_VAL;
  for (int end = 0; end < 2; ++end) {
    const double *centre = end ? after : before, edge = radius - fabs(u - centre[0]);
    const double square = edge * (2.0 * radius - edge);
    if (square < 0.0) continue;
    const double low = centre[1] - sqrt(square);
    height = low < height ? low : height;
  }
  const double step[2] = {after[0] - before[0], after[1] - before[1]};
  const double length = hypot(step[0], step[1]), width = fabs(step[0]);
  if (!(width > 0.0)) return height;
  const double sign = step[0] < 0.0 ? -1.0 : 1.0;
  const double left[2] = {before[0] + radius * sign * step[1] / length,
                          before[1] - radius * sign * step[0] / length};
  const double along = sign * (u - left[0]);
  if (along >= 0.0 && along <= width) {
    const double tangent = left[1] + along / width * step[1];
    height = tangent < height ? tangent : height;
  }
  return height;
}

static double swept_area(const lts_field *soil) {
  double sum = 0.0;
  for (int k = 0; k < soil->model->n_bin; ++k) sum += soil->surface[k] - soil->profile[k];
  return soil->model->bin * sum;
}

/* Cuts on the way to `position`; of bins that are cut for the first time notes the area before. */
static void cut(lts_field *soil, const double position[2], double area) {
  const lts_field_model *m = soil->model;
  lts_field_head *h = soil->head;
  const double *from = h->position;
  h->travelled += hypot(position[0] - from[0], position[1] - from[1]);
  const double low = fmin(from[0], position[0]) - m->radius - h->ground.origin - m->first;
  const double high = fmax(from[0], position[0]) + m->radius - h->ground.origin - m->first;
  int begin = (int)fmax(floor(low / m->bin), 0.0), passed = 0;
  const int end = (int)fmin(ceil(high / m->bin) + 1.0, (double)m->n_bin);
  for (int k = begin; k < end; ++k) {
    const double u = h->ground.origin + (m->first + k * m->bin);
    const double height = lts_field_underside(u, from, position, m->radius);
    const int was_cut = soil->profile[k] < soil->surface[k];
    if (height < soil->profile[k]) soil->profile[k] = height;
    if (!(height < soil->surface[k])) continue;
    passed = 1;
    soil->last[k] = h->travelled;
    if (!was_cut) soil->area_before[k] = area;
  }
  if (passed && position[0] > h->foremost) h->foremost = position[0];
  memcpy(h->position, position, sizeof h->position);
}

/* (20) of `tool/blade.py`, of an edge that goes on to `position`. */
static double pressed(const lts_field *soil, const double position[2]) {
  const lts_field_model *m = soil->model;
  const lts_field_head *h = soil->head;
  const double at = (position[0] - h->ground.origin - m->first) / m->bin;
  const double place = fmin(fmax(at, 0.0), m->n_bin - 1.0);
  const int low = place < m->n_bin - 2 ? (int)place : m->n_bin - 2;
  const double share = place - low;
  const double uncut = (1.0 - share) * soil->profile[low] + share * soil->profile[low + 1];
  const double bottom = position[1] - m->radius, was = h->position[1] - m->radius;
  if (bottom > uncut + m->touch) return 0.0;
  const double along = fabs(position[0] - h->position[0]);
  return fmax(h->pressed + fmin(was, uncut) - bottom - m->steep * along, 0.0);
}

void lts_field_begin(lts_field *soil, const double plane[3], const double velocity[3]) {
  const lts_field_model *m = soil->model;
  lts_field_head *h = soil->head;
  memcpy(h->position, plane, sizeof h->position);
  h->lean = plane[2];
  h->foremost = plane[0];
  h->travelled = h->pressed = 0.0;
  memcpy(h->velocity, velocity, sizeof h->velocity);
  for (int i = 0; i < m->n_scale; ++i) memcpy(h->memory[i], velocity, sizeof h->memory[i]);
  memcpy(soil->profile, soil->surface, (size_t)m->n_bin * sizeof *soil->profile);
  for (int k = 0; k < m->n_bin; ++k) {
    soil->last[k] = -m->forget;
    soil->area_before[k] = 0.0;
  }
  cut(soil, plane, 0.0);
}

void lts_field_remember(lts_field *soil, double dt) {
  lts_field_head *h = soil->head;
  for (int i = 0; i < soil->model->n_scale; ++i) {
    const double fade = exp(-dt / soil->model->time_scales[i]);
    for (int k = 0; k < 3; ++k) {
      h->memory[i][k] = fade * h->memory[i][k] + (1.0 - fade) * h->velocity[k];
    }
  }
}

void lts_field_go(lts_field *soil, const double plane[3], double dt) {
  lts_field_head *h = soil->head;
  h->velocity[0] = (plane[0] - h->position[0]) / dt;
  h->velocity[1] = (plane[1] - h->position[1]) / dt;
  h->velocity[2] = (plane[2] - h->lean) / dt;
  lts_field_remember(soil, dt);
  h->pressed = pressed(soil, plane);
  cut(soil, plane, swept_area(soil));
  h->lean = plane[2];
}

/* Beyond the bins the outermost ones go on. */
void lts_field_pad(lts_field *soil) {
  const lts_field_model *m = soil->model;
  for (int i = 0; i < LTS_CHANNELS; ++i) {
    float *channel = soil->bins[i];
    for (int k = 1; k <= 2 * m->n_pad; ++k) channel[-k] = channel[0];
    for (int k = 0; k <= 2 * m->n_pad; ++k) channel[m->n_bin + k] = channel[m->n_bin - 1];
  }
}

void lts_field_see(lts_field *soil) {
  const lts_field_model *m = soil->model;
  const lts_field_head *h = soil->head;
  for (int k = 0; k < m->n_bin; ++k) {
    const double since = h->travelled - soil->last[k];
    soil->bins[LTS_CUT][k] = (float)(soil->surface[k] - soil->profile[k]);
    soil->bins[LTS_SURFACE][k] = (float)(soil->surface[k] - h->ground.level);
    soil->bins[LTS_SINCE][k] = (float)(since < m->forget ? since : m->forget);
    soil->bins[LTS_AREA_BEFORE][k] = (float)soil->area_before[k];
  }
  float *s = soil->scalars;
  *s++ = (float)(h->position[0] - h->ground.origin);
  *s++ = (float)(h->position[1] - h->ground.level);
  *s++ = (float)h->lean;
  for (int k = 0; k < 3; ++k) *s++ = (float)h->velocity[k];
  for (int i = 0; i < m->n_scale; ++i) {
    for (int k = 0; k < 3; ++k) *s++ = (float)h->memory[i][k];
  }
  *s++ = (float)swept_area(soil);
  *s++ = (float)(h->foremost - h->ground.origin);
  *s++ = (float)(0.5 * h->ground.width);
  *s++ = (float)(h->ground.end - h->ground.origin);
  *s++ = (float)(h->ground.end - h->foremost);
  *s++ = (float)h->pressed;
}

/* The largest of all values, each lowered by `fall` per bin of distance; times `scale`, in [0, most]. */
void lts_field_cone(const double *values, int n, double fall, float scale, float most, float *out) {
  double best = -HUGE_VAL;
  for (int k = 0; k < n; ++k) {
    best = fmax(best - fall, values[k]);
    out[k] = (float)best;
  }
  best = -HUGE_VAL;
  for (int k = n - 1; k >= 0; --k) {
    best = fmax(best - fall, values[k]);
    const float value = scale * fmaxf((float)best, out[k]);
    out[k] = value < 0.0f ? 0.0f : value > most ? most : value;
  }
}

void lts_field_see_reach(lts_field *soil) {
  const lts_field_model *m = soil->model;
  double *depth = soil->top, *influence = soil->median;
  soil->axis[0] = -m->length * sin(soil->head->lean);
  soil->axis[1] = m->length * cos(soil->head->lean);
  for (int k = 0; k < m->n_bin; ++k) {
    depth[k] = soil->surface[k] - soil->profile[k];
    influence[k] = fmin(depth[k] / m->touch, 1.0);
  }
  lts_field_cone(influence, m->n_bin, m->bin / m->reach, 3.0f, 1.0f, soil->bins[LTS_INFLUENCE]);
  lts_field_cone(depth, m->n_bin, m->rise * m->bin, 1.0f, HUGE_VALF, soil->bins[LTS_DISTURBED]);
  lts_field_pad(soil);
}
