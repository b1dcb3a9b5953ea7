/* How a driven wheel begins: where a recorded one stood, in its own print; and the load of what comes. */
#include <math.h>
#include <string.h>

#include "lts_field_internal.h"

void lts_field_wheel_plane(const lts_field *soil, double plane[4]) {
  const double pi = 3.14159265358979323846, last = soil->head->drive.turned;
  double turned = -plane[2];
  /* The nearest to the angle before, as `numpy.unwrap`. */
  const double change = turned - last;
  if (!(fabs(change) < pi)) turned -= 2.0 * pi * floor((change + pi) / (2.0 * pi));
  plane[2] = turned;
  plane[3] = soil->head->context[soil->model->load];
}

static int usable_start(const lts_field_model *m, int start) {
  if (m->tool != LTS_FIELD_WHEEL) return LTS_ERROR_CALL;
  return start < -1 || start >= m->n_start ? LTS_ERROR_VALUE : LTS_OK;
}

/* Which start has the nearest context; the first where none is given. */
static int nearest(const lts_field_model *m, const double *context) {
  double least = HUGE_VAL;
  int best = 0;
  for (int i = 0; context && i < m->n_start; ++i) {
    const double far = lts_far(context, m->starts[i].context, m->context_scale, m->n_context);
    if (far < least) best = i;
    if (far < least) least = far;
  }
  return best;
}

/* Particles [N][3] of the bed of a start. */
static void recorded_bed(const lts_field_model *m, const lts_field_start_data *start, float *points) {
  for (int i = 0; i < m->n_soil; ++i) {
    double sum[3];
    for (int axis = 0; axis < 3; ++axis) sum[axis] = m->bed_mean[3 * i + axis];
    for (int k = 0; k < m->n_mode; ++k) {
      const double component = m->bed_components[(size_t)i * (size_t)m->n_mode + (size_t)k];
      for (int axis = 0; axis < 3; ++axis) sum[axis] += component * start->modes[3 * k + axis];
    }
    for (int axis = 0; axis < 3; ++axis) points[3 * i + axis] = (float)sum[axis];
  }
}

static lts_pose pose_of(const lts_field_start_data *start) {
  lts_pose pose;
  memcpy(pose.position, start->pose, sizeof pose.position);
  memcpy(pose.rotation, start->pose + 3, sizeof pose.rotation);
  return pose;
}

/* Whether a wheel can have such a load on such a planet. */
static int usable_context(const lts_field_model *m, const double *context) {
  return lts_all_finite(context, (size_t)m->n_context) && context[m->load] > 0.0 &&
         context[m->gravity] > 0.0;
}

int lts_field_start_wheel(lts_field *soil, int start, const lts_pose *pose, const lts_twist *twist,
                          const lts_field_bed *bed, const double *context) {
  LTS_TRY(lts_field_check(soil));
  const lts_field_model *m = soil->model;
  LTS_TRY(usable_start(m, start));
  if ((context && !usable_context(m, context)) || (twist && !lts_usable_twist(twist))) {
    return LTS_ERROR_VALUE;
  }
  const lts_field_start_data *from = &m->starts[start < 0 ? nearest(m, context) : start];
  if (!context) context = from->context;
  const lts_pose where = pose ? *pose : pose_of(from);
  double plane[4], velocity[3];
  if (!lts_field_plane_of(m, &where, plane)) return LTS_ERROR_VALUE;
  plane[2] = -plane[2];
  plane[3] = context[m->load];
  const float *points = soil->points;
  LTS_TRY(bed ? lts_field_take_bed(soil, bed, &points) : LTS_OK);
  if (!bed) {
    soil->placed = 0;
    recorded_bed(m, from, soil->points);
  }
  lts_field_drive drive;
  memset(&drive, 0, sizeof drive);
  drive.radius = from->radius;
  drive.width = from->width;
  drive.gravity = context[m->gravity];
  drive.friction = tan(context[m->friction] * (3.14159265358979323846 / 180.0));
  lts_field_rates(m, twist, velocity);
  velocity[1] = -velocity[2] * drive.radius; /* of the rim */
  velocity[2] = 0.0;
  return lts_field_begin_on(soil, &where, plane, velocity, points, 1, drive.width, &drive, context);
}

int lts_field_start_pose(const lts_field_model *m, int start, lts_pose *out) {
  if (!m || !out) return LTS_ERROR_NULL;
  if (usable_start(m, start) || start < 0) return LTS_ERROR_VALUE;
  *out = pose_of(&m->starts[start]);
  return LTS_OK;
}

int lts_field_start_context(const lts_field_model *m, int start, double *context) {
  if (!m || !context) return LTS_ERROR_NULL;
  if (usable_start(m, start) || start < 0) return LTS_ERROR_VALUE;
  memcpy(context, m->starts[start].context, (size_t)m->n_context * sizeof *context);
  return LTS_OK;
}

int lts_field_set_context(lts_field *soil, const double *context) {
  LTS_TRY(lts_field_check_started(soil));
  const lts_field_model *m = soil->model;
  if (m->tool != LTS_FIELD_WHEEL) return LTS_ERROR_CALL;
  if (!context) return LTS_ERROR_NULL;
  if (!usable_context(m, context)) return LTS_ERROR_VALUE;
  double *now = soil->head->context;
  for (int k = 0; k < m->n_context; ++k) {
    const int same = fabs(context[k] - now[k]) <= 1e-8 + 1e-5 * fabs(now[k]);
    if (k != m->load && !same) return LTS_ERROR_VALUE;
  }
  memcpy(now, context, (size_t)m->n_context * sizeof *now);
  return LTS_OK;
}

int lts_field_context(const lts_field *soil, double *context) {
  LTS_TRY(lts_field_check_started(soil));
  if (!context) return LTS_ERROR_NULL;
  memcpy(context, soil->head->context, (size_t)soil->model->n_context * sizeof *context);
  return LTS_OK;
}
