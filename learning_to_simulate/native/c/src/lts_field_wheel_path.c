/* What a driven wheel has done so far, and the rut it leaves: twin of `tool/wheel.py`, for one wheel. */
#include <math.h>
#include <string.h>

#include "lts_field_internal.h"

static double offset_of(const lts_field_model *m, int k) { return m->bin * (double)(k - m->n_behind); }

/* In [0, 1]: how much of the pressure in the middle of the contact a bin bears, of a wheel at `place`. */
static double bearing(const lts_field *soil, int k, double place) {
  const lts_field_head *h = soil->head;
  const double half = h->drive.contact;
  const double edge = h->drive.radius - fabs(h->ground.origin + offset_of(soil->model, k) - place);
  const double inside = edge - (h->drive.radius - half);
  return fmax(inside * (2.0 * half - inside) / (half * half), 0.0);
}

static double share_of(const lts_field_model *m, double borne) { return fmin(borne / m->borne, 1.0); }

/* Before the wheel was set down the bed was level with what lies beside the contact; a wheel as wide as
 * all bins leaves it as it is. */
static void level_print(lts_field *soil) {
  const lts_field_model *m = soil->model;
  const lts_field_drive *d = &soil->head->drive;
  const double width = fmin(d->contact + 2 * m->bin, d->radius);
  int low = -1, high = m->n_bin;
  for (int k = 0; k < m->n_bin; ++k) {
    if (fabs(offset_of(m, k)) < width) continue;
    if (k < m->n_behind) low = k;
    if (k > m->n_behind && k < high) high = k;
  }
  const int has_low = low >= 0, has_high = high < m->n_bin;
  if (!has_low && !has_high) return;
  for (int k = low + 1; k < high; ++k) {
    const double left = soil->surface[has_low ? low : high];
    const double right = soil->surface[has_high ? high : low];
    soil->surface[k] = left + (right - left) * (double)(k - low) / (double)(high - low);
  }
}

void lts_field_wheel_begin(lts_field *soil, const double plane[4], const double velocity[3]) {
  const lts_field_model *m = soil->model;
  lts_field_head *h = soil->head;
  lts_field_drive *d = &h->drive;
  memcpy(h->position, plane, sizeof h->position);
  memcpy(h->velocity, velocity, sizeof h->velocity);
  for (int i = 0; i < m->n_scale; ++i) memcpy(h->memory[i], velocity, sizeof h->memory[i]);
  d->first_height = plane[1];
  d->first_turned = d->turned = plane[2];
  d->first_load = d->load = d->frame_load = d->peak_load = plane[3];
  d->sunk = h->ground.level - (plane[1] - d->radius);
  const double sunk = fmin(fmax(d->sunk, 0.002), d->radius);
  d->contact = sqrt(sunk * (2.0 * d->radius - sunk));
  d->rearmost = d->foremost = plane[0];
  memset(d->way, 0, sizeof d->way);
  level_print(soil);
  for (int k = 0; k < m->n_bin; ++k) {
    const double u = h->ground.origin + offset_of(m, k), borne = bearing(soil, k, plane[0]);
    const double rim = lts_field_underside(u, plane, plane, d->radius);
    soil->last[k] = borne > 0.0 ? 0.0 : -m->forget;
    soil->slid[k] = soil->shear[k] = 0.0;
    soil->peak[k] = share_of(m, borne) * plane[3];
    soil->profile[k] = soil->first[k] = rim < soil->surface[k] ? rim : soil->surface[k];
  }
}

void lts_field_wheel_drive(lts_field *soil, const double plane[4], double dt) {
  const lts_field_model *m = soil->model;
  lts_field_head *h = soil->head;
  lts_field_drive *d = &h->drive;
  const double from = h->position[0];
  const double step[2] = {plane[0] - from, d->radius * (plane[2] - d->turned)};
  const double slip = step[1] - step[0], load = plane[3];
  h->velocity[0] = step[0] / dt;
  h->velocity[1] = step[1] / dt;
  lts_field_remember(soil, dt);
  d->way[0] += fabs(step[0]);
  d->way[1] += fabs(slip);
  d->way[2] += fabs(load - d->load) / fmax(d->first_load, 1e-9);
  for (int k = 0; k < m->n_bin; ++k) {
    /* What a place bears in a frame is the mean of that at both ends. */
    const double after = bearing(soil, k, plane[0]);
    const double borne = 0.5 * (bearing(soil, k, from) + after);
    if (after > 0.0) soil->last[k] = d->way[0];
    soil->slid[k] += borne * fabs(slip);
    soil->shear[k] += borne * slip;
    soil->peak[k] = fmax(soil->peak[k], share_of(m, after) * load);
  }
  d->frame_load = 0.5 * (load + d->load);
  d->peak_load = fmax(d->peak_load, load);
  d->rearmost = fmin(d->rearmost, plane[0]);
  d->foremost = fmax(d->foremost, plane[0]);
  d->turned = plane[2];
  d->load = load;
  h->position[0] = plane[0];
}

void lts_field_wheel_sink(lts_field *soil, const double from[2], double height) {
  const lts_field_model *m = soil->model;
  lts_field_head *h = soil->head;
  h->position[1] = height;
  for (int k = 0; k < m->n_bin; ++k) {
    const double u = h->ground.origin + offset_of(m, k);
    const double rim = lts_field_underside(u, from, h->position, h->drive.radius);
    if (rim < soil->profile[k]) soil->profile[k] = rim;
  }
}

/* In the order of `wheel.SCALARS`. */
void lts_field_wheel_see(lts_field *soil) {
  const lts_field_model *m = soil->model;
  const lts_field_head *h = soil->head;
  const lts_field_drive *d = &h->drive;
  const double first = h->ground.origin;
  double area = 0.0;
  for (int k = 0; k < m->n_bin; ++k) {
    const double since = d->way[0] - soil->last[k];
    soil->bins[LTS_SINCE][k] = (float)(since < m->forget ? since : m->forget);
    soil->bins[LTS_SLID][k] = (float)soil->slid[k];
    soil->bins[LTS_SHEAR][k] = (float)soil->shear[k];
    soil->bins[LTS_PEAK][k] = (float)soil->peak[k];
    area += soil->first[k] - soil->profile[k];
  }
  const double stirred = d->way[0] / m->stir + d->way[1] / m->stir + d->way[2] / m->stir_load;
  float *s = soil->scalars;
  *s++ = (float)(h->position[0] - first);
  *s++ = (float)(d->radius * (d->turned - d->first_turned));
  for (int k = 0; k < 2; ++k) *s++ = (float)h->velocity[k];
  for (int i = 0; i < m->n_scale; ++i) {
    for (int k = 0; k < 2; ++k) *s++ = (float)h->memory[i][k];
  }
  const double rest[] = {
      d->way[0], d->way[1], d->foremost - first, d->rearmost - first, d->load, d->frame_load,
      d->peak_load, d->first_load, d->radius, 0.5 * d->width, d->gravity, d->friction, d->sunk,
      d->contact, h->ground.end - first, h->ground.end - d->foremost, fmin(stirred, 1.0),
      h->position[1] - h->ground.level, m->bin * area};
  for (size_t k = 0; k < sizeof rest / sizeof *rest; ++k) *s++ = (float)rest[k];
}

void lts_field_wheel_see_reach(lts_field *soil) {
  const lts_field_model *m = soil->model;
  const lts_field_head *h = soil->head;
  double *depth = soil->top, *touched = soil->median;
  const float stirred = soil->scalars[m->n_scalar - 3];
  for (int k = 0; k < m->n_bin; ++k) {
    depth[k] = soil->surface[k] - soil->profile[k];
    const double borne = fmin(soil->peak[k] / fmax(h->drive.first_load, 1e-9), 1.0);
    touched[k] = fmax(borne, fmin(depth[k] / m->touch, 1.0));
    soil->bins[LTS_CUT][k] = (float)depth[k];
    soil->bins[LTS_SURFACE][k] = (float)(soil->surface[k] - h->ground.level);
    soil->bins[LTS_FIRST_CUT][k] = (float)(soil->surface[k] - soil->first[k]);
  }
  lts_field_cone(touched, m->n_bin, m->bin / m->reach, 3.0f, 1.0f, soil->bins[LTS_INFLUENCE]);
  for (int k = 0; k < m->n_bin; ++k) soil->bins[LTS_INFLUENCE][k] *= stirred;
  lts_field_cone(depth, m->n_bin, m->rise * m->bin, 1.0f, HUGE_VALF, soil->bins[LTS_DISTURBED]);
  lts_field_pad(soil);
}
