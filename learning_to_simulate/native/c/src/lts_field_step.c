/* Start, steps and the force of a swept field; twin of `swept_field/engine.py`. */
#include <math.h>
#include <string.h>

#include "lts_field_internal.h"

int lts_field_plane_of(const lts_field_model *m, const lts_pose *pose, double plane[3]) {
  double up[3] = {0.0, 0.0, 0.0};
  lts_pose unit;
  if (!lts_usable_pose(pose, &unit)) return 0;
  up[m->up] = 1.0;
  lts_rotate(unit.rotation, up, up);
  plane[0] = m->sign * pose->position[m->axis];
  plane[1] = pose->position[m->up];
  plane[2] = atan2(-m->sign * up[m->axis], up[m->up]);
  return 1;
}

void lts_field_rates(const lts_field_model *m, const lts_twist *twist, double velocity[3]) {
  velocity[0] = twist ? m->sign * twist->linear[m->axis] : 0.0;
  velocity[1] = twist ? twist->linear[m->up] : 0.0;
  velocity[2] = twist ? m->turn * twist->angular[3 - m->axis - m->up] : 0.0;
}

/* What no network sees, twin of `calibration.conditions`: yaw, roll, distance from the middle plane, way across
 * over way, lowest and highest place of the bed, duration. All are 0 in the air. */
static void find_conditions(const lts_field *soil, const lts_pose *before, double dt,
                            double found[LTS_FIELD_CONDITIONS]) {
  const lts_field_model *m = soil->model;
  const lts_pose *now = &soil->head->pose;
  const int across = 3 - m->axis - m->up;
  const double w = now->rotation[0], a = now->rotation[1 + m->axis], u = now->rotation[1 + m->up],
               c = now->rotation[1 + across], turn = m->sign * m->turn;
  /* Where the rotation takes the axis across. */
  const double along = 2.0 * (a * c + turn * w * u), rise = 2.0 * (u * c - turn * w * a),
               aside = w * w + c * c - a * a - u * u;
  double step[3], low = HUGE_VAL, high = -HUGE_VAL;
  float share[3];
  memset(found, 0, LTS_FIELD_CONDITIONS * sizeof *found);
  if (!soil->tool->load_share(soil, share)) return;
  for (int i = 0; i < 3; ++i) step[i] = before ? now->position[i] - before->position[i] : 0.0;
  for (int i = 0; i < m->n_bin; ++i) {
    low = fmin(low, soil->bins[LTS_SURFACE][i]);
    high = fmax(high, soil->bins[LTS_SURFACE][i]);
  }
  found[0] = atan2(m->sign * along, aside);
  found[1] = atan2(rise, hypot(along, aside));
  found[2] = now->position[across] - m->middle;
  found[3] = fabs(step[across]) / fmax(hypot(step[m->axis], step[m->up]), m->least_speed * dt);
  found[4] = low;
  found[5] = high;
  found[6] = dt;
}

/* Status of the newest frame, and why; `before` is the pose of the one before, or null. */
static int judge(lts_field *soil, const lts_field_result *result, const lts_pose *before, double dt) {
  const lts_field_model *m = soil->model;
  const int n = m->n_scalar, n_all = n + LTS_FIELD_CONDITIONS;
  lts_judgement *judged = &soil->head->judged;
  const lts_judgement well = {LTS_OK, -1, -1, -1, 0.0, 0.0, 0.0};
  double conditions[LTS_FIELD_CONDITIONS];
  int status = LTS_OK;
  *judged = well;
  find_conditions(soil, before, dt, conditions);
  for (int i = 0; i < n_all; ++i) {
    const double value = i < n ? soil->scalars[i] : conditions[i - n];
    const double *limits = m->limits + i;
    if (value >= limits[0] && value <= limits[n_all]) continue;
    const lts_judgement found = {m->bits[i],         soil->head->frame, -1, i, value,
                                 limits[2 * n_all], limits[3 * n_all]};
    if (!status) *judged = found;
    status |= m->bits[i];
  }
  for (int k = 0; k < 3; ++k) {
    if (isfinite(result->force[k]) && isfinite(result->torque[k]) && isfinite(result->point[k])) {
      continue;
    }
    const lts_judgement found = {LTS_NON_FINITE,    soil->head->frame, -1,      -1,
                                 result->force[k], -HUGE_VAL,         HUGE_VAL};
    *judged = found;
    status |= LTS_NON_FINITE;
  }
  return status;
}

/* Judges the newest state; needs `see`. */
static int answer(lts_field *soil, const lts_pose *before, double dt) {
  const lts_field_model *m = soil->model;
  lts_field_head *head = soil->head;
  lts_field_result *result = &head->result;
  if (m->tool == LTS_FIELD_WHEEL) head->pose.position[m->up] = head->position[1];
  memcpy(result->point, head->pose.position, sizeof result->point);
  result->frame = head->frame;
  result->status = judge(soil, result, before, dt);
  soil->placed = 0;
  return result->status;
}

int lts_field_begin_on(lts_field *soil, const lts_pose *pose, const double plane[4],
                       const double velocity[3], const float *points, int has_bed, double width,
                       const lts_field_drive *drive, const double *context) {
  const lts_field_model *m = soil->model;
  const size_t n = 3 * (size_t)m->n_soil;
  lts_field_ground ground;
  LTS_TRY(lts_field_read_bed(soil, points, plane[0], width, soil->heights, &ground));
  lts_field_head *head = soil->head;
  double values[LTS_FIELD_CONTEXT] = {0.0}; /* `context` may be that of the head */
  for (int i = 0; i < m->n_context; ++i) values[i] = context[i];
  lts_field_drive sizes; /* likewise */
  memset(&sizes, 0, sizeof sizes);
  if (drive) sizes = *drive;
  memset(head, 0, lts_aligned(sizeof *head, 8));
  memcpy(soil->surface, soil->heights, (size_t)m->n_bin * sizeof *soil->surface);
  if (has_bed) memmove(soil->bed, points, n * sizeof *points);
  if (has_bed) soil->has_local = 0;
  head->started = 1;
  head->has_bed = has_bed;
  head->ground = ground;
  head->pose = *pose;
  head->drive = sizes;
  memcpy(head->context, values, sizeof values);
  if (drive) {
    lts_field_wheel_begin(soil, plane, velocity);
  } else {
    lts_field_begin(soil, plane, velocity);
  }
  soil->tool->see(soil);
  return answer(soil, NULL, m->dt);
}

int lts_field_start(lts_field *soil, const lts_pose *pose, const lts_twist *twist,
                    const lts_field_bed *bed, double blade_width) {
  LTS_TRY(lts_field_check(soil));
  if (!pose) return LTS_ERROR_NULL;
  const lts_field_model *m = soil->model;
  double plane[4], velocity[3];
  if (m->tool != LTS_FIELD_BLADE) return LTS_ERROR_CALL;
  if (!lts_field_plane_of(m, pose, plane) || (twist && !lts_usable_twist(twist))) {
    return LTS_ERROR_VALUE;
  }
  if (!(blade_width >= 0.0 && isfinite(blade_width))) return LTS_ERROR_VALUE;
  const float *points = m->rest;
  LTS_TRY(bed ? lts_field_take_bed(soil, bed, &points) : LTS_OK);
  lts_field_rates(m, twist, velocity);
  return lts_field_begin_on(soil, pose, plane, velocity, points, bed != NULL,
                            blade_width > 0.0 ? blade_width : m->width, NULL, NULL);
}

int lts_field_renew(lts_field *soil) {
  LTS_TRY(lts_field_check_started(soil));
  const lts_field_head *h = soil->head;
  const lts_pose pose = h->pose;
  const double plane[4] = {h->position[0], h->position[1],
                           soil->model->tool == LTS_FIELD_WHEEL ? h->drive.turned : h->lean,
                           h->drive.load};
  const double velocity[3] = {h->velocity[0], h->velocity[1], h->velocity[2]};
  const lts_field_drive *drive = soil->model->tool == LTS_FIELD_WHEEL ? &h->drive : NULL;
  lts_field_place_particles(soil);
  return lts_field_begin_on(soil, &pose, plane, velocity, soil->points, 1, h->ground.width, drive,
                            h->context);
}

/* A wheel goes on: what is given first, then the height that follows from it. The state is put back where
 * that is refused. */
static int go_wheel(lts_field *soil, const double plane[4], double dt) {
  const lts_field_model *m = soil->model;
  lts_field_head *head = soil->head;
  const lts_field_drive *d = &head->drive;
  const size_t size = lts_field_bytes(m, 0);
  const double from[2] = {head->position[0], head->position[1]};
  lts_field_result result = head->result;
  memcpy(soil->before, head, size);
  lts_field_wheel_drive(soil, plane, dt);
  soil->tool->see(soil);
  const double height = d->first_height + lts_field_find_load(soil, &result);
  if (height - d->radius < head->ground.floor) {
    memcpy(head, soil->before, size);
    return LTS_ERROR_PLACE;
  }
  head->result = result;
  lts_field_wheel_sink(soil, from, height);
  soil->tool->see(soil); /* height and area have changed */
  return LTS_OK;
}

int lts_field_frame(lts_field *soil, const lts_pose *pose, double dt, lts_field_result *result) {
  LTS_TRY(lts_field_check_started(soil));
  if (!pose) return LTS_ERROR_NULL;
  const lts_field_model *m = soil->model;
  const int is_wheel = m->tool == LTS_FIELD_WHEEL;
  lts_field_head *head = soil->head;
  double plane[4];
  if (!lts_field_plane_of(m, pose, plane) || !(dt > 0.0 && isfinite(dt))) return LTS_ERROR_VALUE;
  if (is_wheel) lts_field_wheel_plane(soil, plane);
  const double rise = is_wheel ? 0.0 : plane[1] - head->position[1];
  const double turn = plane[2] - (is_wheel ? head->drive.turned : head->lean);
  const double speed = hypot(plane[0] - head->position[0], rise) / dt;
  if (!(speed <= m->fastest && fabs(turn) / dt <= m->fastest_turn)) return LTS_ERROR_JUMP;
  const double offset = plane[0] - head->ground.origin, last = m->first + (m->n_bin - 1) * m->bin;
  const double radius = is_wheel ? head->drive.radius : m->radius;
  if (!is_wheel && plane[1] - m->blade_radius < head->ground.floor) return LTS_ERROR_PLACE;
  if (!(offset - radius >= m->first && offset + radius <= last)) return LTS_ERROR_PLACE;
  if (is_wheel) {
    LTS_TRY(go_wheel(soil, plane, dt));
  } else {
    lts_field_go(soil, plane, dt);
    soil->tool->see(soil);
    lts_field_find_load(soil, &head->result);
  }
  const lts_pose before = head->pose;
  head->pose = *pose;
  if (head->frame < INT32_MAX) ++head->frame;
  const int status = answer(soil, &before, dt);
  if (result) *result = head->result;
  return status;
}

int lts_field_advance(lts_field *soil, double h, const lts_pose *pose, const lts_twist *twist,
                      lts_field_result *result) {
  LTS_TRY(lts_field_check_started(soil));
  if (!pose || !twist) return LTS_ERROR_NULL;
  lts_pose coming;
  if (!lts_usable_pose(pose, &coming) || !lts_usable_twist(twist)) return LTS_ERROR_VALUE;
  if (!(h > 0.0 && isfinite(h))) return LTS_ERROR_VALUE;
  lts_moved_pose(&coming, twist, h, &coming);
  return lts_field_frame(soil, &coming, h, result);
}

int lts_field_newest(const lts_field *soil, lts_field_result *result) {
  LTS_TRY(lts_field_check_started(soil));
  if (!result) return LTS_ERROR_NULL;
  *result = soil->head->result;
  return result->status;
}

int lts_field_judge(const lts_field *soil, lts_judgement *out) {
  LTS_TRY(lts_field_check_started(soil));
  if (!out) return LTS_ERROR_NULL;
  *out = soil->head->judged;
  return soil->head->result.status;
}

int lts_field_reason(const lts_field *soil, char *text, size_t size) {
  lts_judgement found;
  const int status = lts_field_judge(soil, &found);
  if (status < 0) return status;
  if (!text) return LTS_ERROR_NULL;
  char name[LTS_LONGEST_NAME] = "a prediction";
  if (found.axis >= 0) lts_name_of(soil->model->scalar_names, found.axis, name, sizeof name);
  lts_say(&found, name, text, size);
  return status;
}
