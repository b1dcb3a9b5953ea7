/* How far a frame can be trusted: the same limits as a rollout of the project is judged by. */
#include <math.h>
#include <stdio.h>

#include "lts_internal.h"

int lts_check_started(const lts_instance *soil) {
  LTS_TRY(lts_check(soil));
  return soil->state.head->started ? LTS_OK : LTS_ERROR_CALL;
}

double lts_ungiven_height(const lts_model *m, const double *points, const double *from) {
  double height = 0.0;
  if (m->motion != LTS_DRIVEN) return 0.0;
  for (int i = 0; i < m->n_rigid; ++i) {
    const int k = 3 * i + m->up_axis;
    height += (points[k] - (from ? from[k] : 0.0)) / m->n_rigid;
  }
  return height;
}

/* Keeps the first judgement of a kind, LTS_WORSE_..., and returns its bit. */
static int note(lts_instance *soil, int kind, lts_judgement found) {
  lts_judgement *worst = &soil->state.head->worst[kind];
  if (worst->frame < 0) *worst = found;
  return found.status;
}

/* The bit if a value is outside the limits i of [4][n]: see lts_model.h. */
static int outside(lts_instance *soil, int bit, int frame, int node, int axis, double value,
                   const double *limits, int i, int n) {
  const lts_judgement found = {bit, frame, node, axis, value, limits[2 * n + i], limits[3 * n + i]};
  if (value >= limits[i] && value <= limits[n + i]) return 0;
  return note(soil, bit == LTS_LEFT_BOUNDS ? LTS_WORSE_BOUNDS : LTS_WORSE_EXTRAPOLATING, found);
}

static int not_finite(lts_instance *soil, int frame, int node, int axis, double value) {
  const lts_judgement found = {LTS_NON_FINITE, frame, node, axis, value, -HUGE_VAL, HUGE_VAL};
  return note(soil, LTS_WORSE_NON_FINITE, found);
}

int lts_check_context(lts_instance *soil, int frame) {
  const lts_model *m = soil->model;
  int bits = 0;
  for (int i = 0; i < m->n_context; ++i) {
    bits |= outside(soil, LTS_OUTSIDE_CONTEXT, frame, -1, i, soil->state.context[i],
                    m->context_range, i, m->n_context);
  }
  return bits;
}

int lts_check_start(lts_instance *soil, int frame, const double *nodes) {
  const lts_model *m = soil->model;
  const int n = 3 * lts_n_node(m);
  int bits = 0;
  for (int i = 0; i < n; ++i) {
    bits |= outside(soil, LTS_OUTSIDE_START, frame, i / 3, i % 3, nodes[i], m->start_range, i, n);
  }
  return bits;
}

int lts_check_given(lts_instance *soil, int frame, const double *before, const double *points) {
  const lts_model *m = soil->model;
  const int n = m->n_rigid;
  const double height = lts_ungiven_height(m, points, NULL);
  const double rise = before ? lts_ungiven_height(m, points, before) : 0.0;
  double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
  double square = 0.0;
  int bits = 0;
  if (n == 0) return 0;
  for (int i = 0; i < 3 * n; ++i) {
    const int axis = i % 3;
    const double value = points[i] - (axis == m->up_axis ? height : 0.0);
    low[axis] = value < low[axis] ? value : low[axis];
    high[axis] = value > high[axis] ? value : high[axis];
    bits |= outside(soil, LTS_OUTSIDE_POSE, frame, i / 3, axis, value, m->given_range, axis, 3);
  }
  for (int i = 0; before && i < 3 * n; ++i) {
    const int axis = i % 3;
    const double v = points[i] - before[i] - (axis == m->up_axis ? rise : 0.0);
    square += v * v / n;
    bits |= outside(soil, LTS_OUTSIDE_SPEED, frame, i / 3, axis, v, m->given_velocity_range, axis, 3);
  }
  for (int axis = 0; axis < 3; ++axis) {
    bits |= outside(soil, LTS_OUTSIDE_POSE, frame, -1, axis, high[axis] - low[axis],
                    m->extent_range, axis, 3);
  }
  if (before) {
    bits |= outside(soil, LTS_OUTSIDE_SPEED, frame, -1, -1, sqrt(square), m->speed_range, 0, 1);
  }
  return bits;
}

int lts_check_predicted(lts_instance *soil, int frame) {
  const lts_model *m = soil->model;
  const int n_node = lts_n_node(m);
  const double *force = soil->state.head->result.force;
  int bits = 0;
  for (int node = 0; node < n_node; ++node) {
    float offset[3];
    lts_node_offset(soil, node, offset);
    for (int axis = 0; axis < 3; ++axis) {
      const int i = 3 * node + axis;
      const double value = (double)offset[axis] + m->origin[i];
      if (!isfinite(value)) bits |= not_finite(soil, frame, node, axis, value);
      if (m->motion == LTS_PRESCRIBED && node < m->n_rigid) continue;
      bits |= outside(soil, LTS_LEFT_BOUNDS, frame, node, axis, value, m->bounds, i, 3 * n_node);
    }
  }
  for (int axis = 0; axis < 3; ++axis) {
    if (!isfinite(force[axis])) bits |= not_finite(soil, frame, -1, axis, force[axis]);
  }
  if (m->force_range) {
    bits |= outside(soil, LTS_LEFT_BOUNDS, frame, -1, -1, lts_length(force, 3), m->force_range, 0, 1);
  }
  return bits;
}

int lts_judge(const lts_instance *soil, lts_judgement *out) {
  LTS_TRY(lts_check_started(soil));
  if (!out) return LTS_ERROR_NULL;
  *out = lts_well;
  for (int kind = 0; kind < LTS_N_WORSE; ++kind) {
    const lts_judgement *worst = &soil->state.head->worst[kind];
    if (worst->frame >= 0) *out = *worst;
  }
  return out->status;
}

int lts_reason(const lts_instance *soil, char *text, size_t size) {
  lts_judgement found;
  const int status = lts_judge(soil, &found);
  if (status < 0) return status;
  if (!text) return LTS_ERROR_NULL;
  char measure[LTS_LONGEST_NAME], name[LTS_LONGEST_NAME];
  const char *axis = found.axis == 0 ? " x" : found.axis == 1 ? " y" : found.axis == 2 ? " z" : "";
  const char *what = found.node >= 0 ? "displacement" : "displacement of the body";
  if (found.status != LTS_OUTSIDE_SPEED) what = found.node >= 0 ? "coordinate" : "extent of the body";
  snprintf(measure, sizeof measure, "%s%s (m)", what, axis);
  if (found.status == LTS_OUTSIDE_CONTEXT) {
    lts_name_of(soil->model->context_names, found.axis, name, sizeof name);
    lts_say(&found, name, text, size);
  } else if (found.status == LTS_LEFT_BOUNDS && found.node < 0) {
    snprintf(text, size, "force %.4g N is above 2 x the largest of training (%.4g N)", found.value,
             2.0 * found.high);
  } else if (found.status == LTS_NON_FINITE) {
    lts_say(&found, found.node >= 0 ? "position" : "force", text, size);
  } else {
    lts_say(&found, measure, text, size);
  }
  return status;
}
