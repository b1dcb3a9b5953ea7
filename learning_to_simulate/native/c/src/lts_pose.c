/* A body given by its pose: start from rest, frames, and a loop of another rate. */
#include <math.h>
#include <string.h>

#include "lts_internal.h"

#define LARGEST_ADVANCE 10000.0   /* frames of one lts_advance */

static int is_start(const lts_model *m, int start) { return start >= 0 && start < m->n_start; }

/* Points of the body of a start at a pose whose rotation is a unit quaternion. */
static void place(const lts_model *m, int start, const lts_pose *pose, double *points) {
  const double *shape = m->starts[start].points;
  double centroid[3];
  lts_centroid(shape, m->n_rigid, centroid);
  for (int i = 0; i < m->n_rigid; ++i) {
    double arm[3];
    for (int axis = 0; axis < 3; ++axis) arm[axis] = shape[3 * i + axis] - centroid[axis];
    lts_rotate(pose->rotation, arm, points + 3 * i);
    for (int axis = 0; axis < 3; ++axis) points[3 * i + axis] += pose->position[axis];
  }
}

int lts_start_pose(const lts_model *model, int start, lts_pose *out) {
  if (!model || !out) return LTS_ERROR_NULL;
  if (model->abi != LTS_ABI) return LTS_ERROR_MODEL;
  if (!is_start(model, start)) return LTS_ERROR_VALUE;
  const lts_pose pose = {{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0, 0.0}};
  *out = pose;
  lts_centroid(model->starts[start].points, model->n_rigid, out->position);
  return LTS_OK;
}

int lts_start_context(const lts_model *model, int start, double *context) {
  if (!model || (model->n_context && !context)) return LTS_ERROR_NULL;
  if (model->abi != LTS_ABI) return LTS_ERROR_MODEL;
  if (!is_start(model, start)) return LTS_ERROR_VALUE;
  for (int i = 0; i < model->n_context; ++i) context[i] = model->starts[start].context[i];
  return LTS_OK;
}

/* The start whose context is nearest, each value counted by its spread in training. */
static int nearest_start(const lts_model *m, const double *context) {
  int best = 0;
  double least = HUGE_VAL;
  for (int start = 0; context && start < m->n_start; ++start) {
    double far = 0.0;
    for (int i = 0; i < m->n_context; ++i) {
      const double d = (context[i] - m->starts[start].context[i]) / m->context_std[i];
      far += d * d;
    }
    if (far < least) best = start;
    if (far < least) least = far;
  }
  return best;
}

int lts_start(lts_instance *soil, int start, const lts_pose *pose, const lts_twist *twist,
              const double *context) {
  LTS_TRY(lts_check(soil));
  const lts_model *m = soil->model;
  const int n_node = lts_n_node(m);
  for (int i = 0; context && i < m->n_context; ++i) {
    if (!isfinite(context[i])) return LTS_ERROR_VALUE;
  }
  if (start == -1 && m->n_start) start = nearest_start(m, m->n_context ? context : NULL);
  if (!is_start(m, start)) return LTS_ERROR_VALUE;
  lts_pose first;
  lts_start_pose(m, start, &first);
  if ((pose && !lts_usable_pose(pose, &first)) || (twist && !lts_usable_twist(twist))) {
    return LTS_ERROR_VALUE;
  }
  const lts_twist rest = {{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}};
  double *history = soil->history;
  for (int f = 0; f < LTS_HISTORY; ++f) {
    double *nodes = history + (size_t)f * 3 * n_node;
    lts_pose then;
    lts_moved_pose(&first, twist ? twist : &rest, (f - LTS_HISTORY + 1) * m->dt, &then);
    place(m, start, &then, nodes);
    memcpy(nodes + 3 * m->n_rigid, m->starts[start].modes, 3 * (size_t)m->n_modes * sizeof(double));
  }
  const int status = lts_reset(soil, history, context ? context : m->starts[start].context);
  if (status >= 0) soil->state.head->start = start;
  return status;
}

int lts_frame_at(lts_instance *soil, const lts_pose *pose, lts_result *result) {
  LTS_TRY(lts_check_started(soil));
  const lts_model *m = soil->model;
  if (!lts_is_given(m)) return pose ? LTS_ERROR_CALL : lts_frame(soil, NULL, result);
  if (!pose) return LTS_ERROR_NULL;
  lts_pose unit;
  if (soil->state.head->start < 0) return LTS_ERROR_CALL;
  if (!lts_usable_pose(pose, &unit)) return LTS_ERROR_VALUE;
  place(m, soil->state.head->start, &unit, soil->history);
  return lts_frame(soil, soil->history, result);
}

int lts_advance(lts_instance *soil, double h, const lts_pose *pose, const lts_twist *twist,
                lts_result *result) {
  LTS_TRY(lts_check_started(soil));
  const lts_model *m = soil->model;
  const int given = lts_is_given(m);
  lts_head *head = soil->state.head;
  if (!(h >= 0.0 && h <= LARGEST_ADVANCE * m->dt)) return LTS_ERROR_VALUE;
  if (given && (!pose || !twist)) return LTS_ERROR_NULL;
  if (given && head->start < 0) return LTS_ERROR_CALL;
  lts_pose now, coming;
  if (given) {
    if (!lts_usable_pose(pose, &now) || !lts_usable_twist(twist)) return LTS_ERROR_VALUE;
    lts_moved_pose(&now, twist, h, &coming);
    if (!lts_usable_pose(&coming, &coming)) return LTS_ERROR_VALUE;
  }
  int status = 0;
  /* Steps of 1 ms do not add up to 1 / 60 s exactly: a frame that is missed by less than a
   * millionth of itself has been reached. */
  const double before = head->elapsed, reached = before + h + 1e-6 * m->dt;
  int n = 0;
  while ((n + 1) * m->dt <= reached) {
    ++n;
    if (given) lts_moved_pose(&now, twist, n * m->dt - before, &coming);
    const int frame = given ? lts_frame_at(soil, &coming, NULL) : lts_frame(soil, NULL, NULL);
    if (frame < 0) return frame;
    status |= frame;
  }
  head->elapsed = before + h - n * m->dt;
  if (!n) status = head->result.status;
  if (result) {
    *result = head->result;
    result->status = status;
  }
  return status;
}
