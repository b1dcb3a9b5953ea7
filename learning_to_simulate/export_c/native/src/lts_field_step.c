/* Start, steps and the force of a swept field; twin of `live.py`. */
#include <math.h>
#include <string.h>

#include "lts_field_internal.h"

/* u, height and lean of an upright tool; 0 where the pose has no numbers or no rotation. */
static int plane_of(const lts_field_model *m, const lts_pose *pose, double plane[3]) {
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

/* Load of the networks into `result`, of mean and spread; needs `lts_field_see`. */
static void find_load(lts_field *soil, lts_field_result *result) {
  const lts_field_model *m = soil->model;
  const lts_kernels *run = soil->run;
  const int latent = LTS_PADDED(m->load_latent), n = soil->of_force;
  const float share = lts_field_contact(soil);
  double mean[3] = {0.0, 0.0, 0.0}, square[3] = {0.0, 0.0, 0.0};
  if (share > 0.0f) {
    lts_dense first = m->load_first;
    first.columns = n * latent;
    lts_field_force_inputs(soil, soil->seen);
    run->dense(&first, soil->seen, m->n_force, 1, soil->a, first.columns, LTS_SILU, NULL, NULL);
    const float scale[3] = {m->force, m->force, m->torque};
    const float half_width = soil->scalars[m->n_scalar - 2];
    for (int member = 0; member < n; ++member) {
      float *x = soil->a + member * latent, *y = soil->b + member * latent;
      for (int k = 0; k < m->n_load_hidden; ++k) {
        const lts_dense *layer = &m->load_hidden[member * m->n_load_hidden + k];
        run->dense(layer, x, latent, 1, y, latent, LTS_SILU, NULL, NULL);
        float *other = x;
        x = y;
        y = other;
      }
      run->dense(&m->load_last[member], x, latent, 1, soil->out, LTS_PANEL, LTS_NORMED, NULL, NULL);
      const float most = m->gain_limit, gain = expf(fminf(fmaxf(soil->out[3], -most), most));
      for (int k = 0; k < 3; ++k) {
        const double load = soil->out[k] * gain * (share * (2.0f * half_width / m->full_width)) *
                            scale[k];
        const double away = load - mean[k]; /* Welford's mean and spread */
        mean[k] += away / (member + 1);
        square[k] += away * (load - mean[k]);
      }
    }
  }
  const int across = 3 - m->axis - m->up;
  memset(result->force, 0, sizeof result->force);
  memset(result->torque, 0, sizeof result->torque);
  result->force[m->axis] = m->sign * mean[0];
  result->force[m->up] = mean[1];
  result->torque[across] = m->turn * mean[2];
  result->force_bound = 0.0;
  if (m->bound) {
    const double spread = sqrt(0.5 * (square[0] + square[1]) / n);
    const double size = sqrt(0.5 * (mean[0] * mean[0] + mean[1] * mean[1]));
    result->force_bound = m->bound[0] + m->bound[1] * spread + m->bound[2] * size;
  }
}

/* Status of the newest frame, and why. */
static int judge(lts_field *soil, const lts_field_result *result) {
  const lts_field_model *m = soil->model;
  lts_judgement *judged = &soil->head->judged;
  const lts_judgement well = {LTS_OK, -1, -1, -1, 0.0, 0.0, 0.0};
  int status = LTS_OK;
  *judged = well;
  for (int i = 0; i < m->n_scalar; ++i) {
    const double value = soil->scalars[i], low = m->limits[i], high = m->limits[m->n_scalar + i];
    if (value >= low && value <= high) continue;
    const lts_judgement found = {m->bits[i], soil->head->frame, -1, i, value, low, high};
    if (!status) *judged = found;
    status |= m->bits[i];
  }
  for (int k = 0; k < 3; ++k) {
    if (isfinite(result->force[k]) && isfinite(result->torque[k])) continue;
    const lts_judgement found = {LTS_NON_FINITE,    soil->head->frame, -1,      -1,
                                 result->force[k], -HUGE_VAL,         HUGE_VAL};
    *judged = found;
    status |= LTS_NON_FINITE;
  }
  return status;
}

/* What the newest state looks like; `with_load`: also what the tool feels. */
static int answer(lts_field *soil, int with_load) {
  lts_field_head *head = soil->head;
  lts_field_result *result = &head->result;
  memcpy(result->point, head->pose.position, sizeof result->point);
  result->frame = head->frame;
  lts_field_see(soil);
  if (with_load) find_load(soil, result);
  result->status = judge(soil, result);
  soil->placed = 0;
  return result->status;
}

int lts_field_start(lts_field *soil, const lts_pose *pose, const lts_twist *twist,
                    const lts_field_bed *bed, double blade_width) {
  const int error = lts_field_check(soil);
  if (error) return error;
  if (!pose) return LTS_ERROR_NULL;
  const lts_field_model *m = soil->model;
  const size_t n = 3 * (size_t)m->n_soil;
  double plane[3];
  if (!plane_of(m, pose, plane) || (twist && !lts_usable_twist(twist))) return LTS_ERROR_VALUE;
  if (!(blade_width >= 0.0 && isfinite(blade_width))) return LTS_ERROR_VALUE;
  const double width = blade_width > 0.0 ? blade_width : m->width;
  const float *points = m->rest;
  if (bed && bed->n) {
    if (!bed->places || !bed->heights) return LTS_ERROR_NULL;
    if (bed->n < 2) return LTS_ERROR_VALUE;
    const int bad = lts_field_stretch(m, bed, soil->points);
    soil->placed = 0;
    if (bad) return bad;
    points = soil->points;
  } else if (bed) {
    if (!bed->particles) return LTS_ERROR_NULL;
    for (size_t i = 0; i < n; ++i) {
      if (!isfinite(bed->particles[i])) return LTS_ERROR_VALUE;
    }
    points = bed->particles;
  }
  /* The state is written once nothing can fail. */
  lts_field_ground ground;
  const int bad = lts_field_read_bed(soil, points, plane[0], width, soil->heights, &ground);
  if (bad) return bad;
  lts_field_head *head = soil->head;
  memset(head, 0, lts_aligned(sizeof *head, 8));
  memcpy(soil->surface, soil->heights, (size_t)m->n_bin * sizeof *soil->surface);
  if (bed) {
    memmove(soil->bed, points, n * sizeof *points);
    soil->has_local = 0;
  }
  head->started = 1;
  head->has_bed = bed != NULL;
  head->ground = ground;
  head->pose = *pose;
  double velocity[3] = {0.0, 0.0, 0.0};
  if (twist) {
    velocity[0] = m->sign * twist->linear[m->axis];
    velocity[1] = twist->linear[m->up];
    velocity[2] = m->turn * twist->angular[3 - m->axis - m->up];
  }
  lts_field_begin(soil, plane, velocity);
  return answer(soil, 0);
}

int lts_field_frame(lts_field *soil, const lts_pose *pose, double dt, lts_field_result *result) {
  const int error = lts_field_check_started(soil);
  if (error) return error;
  if (!pose) return LTS_ERROR_NULL;
  const lts_field_model *m = soil->model;
  lts_field_head *head = soil->head;
  double plane[3];
  if (!plane_of(m, pose, plane) || !(dt > 0.0 && isfinite(dt))) return LTS_ERROR_VALUE;
  const double speed = hypot(plane[0] - head->position[0], plane[1] - head->position[1]) / dt;
  if (!(speed <= m->fastest && fabs(plane[2] - head->lean) / dt <= m->fastest_turn)) {
    return LTS_ERROR_JUMP;
  }
  const double offset = plane[0] - head->ground.origin, last = m->first + (m->n_bin - 1) * m->bin;
  if (plane[1] - m->blade_radius < head->ground.floor) return LTS_ERROR_PLACE;
  if (offset - m->radius < m->first || offset + m->radius > last) return LTS_ERROR_PLACE;
  lts_field_go(soil, plane, dt);
  head->pose = *pose;
  if (head->frame < INT32_MAX) ++head->frame;
  const int status = answer(soil, 1);
  if (result) *result = head->result;
  return status;
}

int lts_field_advance(lts_field *soil, double h, const lts_pose *pose, const lts_twist *twist,
                      lts_field_result *result) {
  const int error = lts_field_check_started(soil);
  if (error) return error;
  if (!pose || !twist) return LTS_ERROR_NULL;
  lts_pose coming;
  if (!lts_usable_pose(pose, &coming) || !lts_usable_twist(twist)) return LTS_ERROR_VALUE;
  if (!(h > 0.0 && isfinite(h))) return LTS_ERROR_VALUE;
  lts_moved_pose(&coming, twist, h, &coming);
  return lts_field_frame(soil, &coming, h, result);
}

int lts_field_judge(const lts_field *soil, lts_judgement *out) {
  const int error = lts_field_check_started(soil);
  if (error) return error;
  if (!out) return LTS_ERROR_NULL;
  *out = soil->head->judged;
  return soil->head->result.status;
}
