/* What the network sees of the state: velocities, offset, accelerations, rate, coming displacement,
 * height of a driven body, context; all over the statistics of the training runs. */
#include <math.h>

#include "lts_internal.h"

int lts_needs_pose(const lts_model *model, int kind) {
  return model->rate_scaled || (kind == LTS_RIGID && model->knows_next);
}

void lts_context_features(lts_instance *soil) {
  const lts_model *m = soil->model;
  for (int i = 0; i < m->n_context; ++i) {
    const double value = soil->state.context[i];
    soil->context_feature[i] = (float)((value - m->context_mean[i]) / m->context_std[i]);
    if (!m->has_log_context) continue;
    /* The floor is far below any positive context; it keeps a zero from becoming infinite. */
    const double logarithm = log(value > 1e-6 ? value : 1e-6);
    soil->context_feature[m->n_context + i] =
        (float)((logarithm - m->log_context_mean[i]) / m->log_context_std[i]);
  }
}

/* Displacement k of a node (0 is the oldest), m, with the height of a driven body. */
static double displacement(const lts_instance *soil, int node, int k, int axis) {
  const lts_model *m = soil->model;
  double v = soil->state.velocity[(node * m->velocity_inputs + k) * 3 + axis];
  if (m->motion == LTS_DRIVEN && node < m->n_rigid && axis == m->up_axis) {
    v += soil->state.head->height_change[LTS_CHANGES - m->velocity_inputs + k];
  }
  return v;
}

void lts_node_offset(const lts_instance *soil, int node, float out[3]) {
  const lts_model *m = soil->model;
  for (int axis = 0; axis < 3; ++axis) out[axis] = soil->state.offset[3 * node + axis];
  if (m->motion == LTS_DRIVEN && node < m->n_rigid) out[m->up_axis] += soil->state.head->height;
}

static float *acceleration_features(const lts_instance *soil, int node, float *out) {
  const lts_model *m = soil->model;
  for (int k = 1; k < m->velocity_inputs; ++k) {
    for (int axis = 0; axis < 3; ++axis) {
      const int i = 3 * node + axis;
      const double change =
          (displacement(soil, node, k, axis) - displacement(soil, node, k - 1, axis)) / soil->rate;
      *out++ = (float)((change - m->acceleration_mean[i]) / m->acceleration_std[i]);
    }
  }
  return out;
}

static float *zeros(int n, float *out) {
  while (n-- > 0) *out++ = 0.0f;
  return out;
}

void lts_features(const lts_instance *soil, int first, int last, float *out) {
  const lts_model *m = soil->model;
  const lts_head *head = soil->state.head;
  const int is_rigid = first < m->n_rigid, last_rigid = last < m->n_rigid ? last : m->n_rigid;
  for (int k = 0; k < m->velocity_inputs; ++k) {
    for (int i = 3 * first; i < 3 * last; ++i) {
      const double v = displacement(soil, i / 3, k, i % 3) / soil->rate;
      *out++ = (float)((v - m->velocity_mean[i]) / m->velocity_std[i]);
    }
  }
  if (m->position_inputs) {
    for (int i = 3 * first; i < 3 * last; ++i) {
      float offset[3];
      lts_node_offset(soil, i / 3, offset);
      *out++ = (float)(offset[i % 3] / m->position_std[i]);
    }
    for (int node = first; node < last; ++node) out = acceleration_features(soil, node, out);
  }
  if (m->rate_scaled) {
    *out++ = logf(soil->rate);
    *out++ = soil->rate;
  }
  /* A mode has 0 where the body has its own. */
  if (m->knows_next) {
    if (!is_rigid) out = zeros(3, out);
    for (int i = 3 * first; i < 3 * last_rigid; ++i) {
      *out++ = (float)((soil->coming[i] / soil->rate - m->velocity_mean[i]) / m->velocity_std[i]);
    }
  }
  if (m->has_height && !is_rigid) out = zeros(LTS_HISTORY, out);
  if (m->has_height && is_rigid) {
    *out++ = (float)(head->height / m->height_std);
    for (int k = 0; k < LTS_CHANGES; ++k) {
      *out++ = (float)(head->height_change[k] / m->height_velocity_std);
    }
  }
  const int n = m->n_context * (m->has_log_context ? 2 : 1);
  for (int i = 0; i < n; ++i) *out++ = soil->context_feature[i];
}
