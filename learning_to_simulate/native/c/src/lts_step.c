/* One frame: what is given of the body, the network, and the integration. */
#include <math.h>
#include <string.h>

#include "lts_internal.h"

int lts_prepare(lts_instance *soil) {
  LTS_TRY(lts_check_started(soil));
  if (!soil->prepared) lts_network_ahead(soil);
  soil->prepared = 1;
  return LTS_OK;
}

/* Displacement of the given points in the coming frame, and its RMS over the training mean. */
static void take_motion(lts_instance *soil, const double *points) {
  const lts_model *m = soil->model;
  const double *before = soil->state.given, rise = lts_ungiven_height(m, points, before);
  double square = 0.0;
  for (int i = 0; i < 3 * m->n_rigid; ++i) {
    const double v = points[i] - before[i] - (i % 3 == m->up_axis ? rise : 0.0);
    soil->coming[i] = (float)v;
    square += v * v / m->n_rigid;
  }
  soil->rate = 1.0f;
  if (!m->rate_scaled) return;
  const double rate = sqrt(square) / m->body_speed;
  soil->rate = (float)(rate > m->rate_floor ? rate : m->rate_floor);
}

/* Predicted displacement of component `axis` of a node from its normalised target. */
static float displacement_of(const lts_instance *soil, int node, int axis, double target, int order,
                             float last) {
  const lts_model *m = soil->model;
  const int i = 3 * node + axis;
  const double v = (target * m->target_std[i] + m->target_mean[i]) * soil->rate;
  return (float)(v + (order == 2 ? last : 0.0f));
}

static float *velocity_of(const lts_instance *soil, int node) {
  return soil->state.velocity + 3 * (size_t)node * soil->model->velocity_inputs;
}

static const float *last_velocity(const lts_instance *soil, int node) {
  return velocity_of(soil, node) + 3 * (soil->model->velocity_inputs - 1);
}

static void push_velocity(lts_instance *soil, int node, const float newest[3]) {
  const size_t kept = 3 * (size_t)(soil->model->velocity_inputs - 1);
  float *history = velocity_of(soil, node);
  memmove(history, history + 3, kept * sizeof *history);
  memcpy(history + kept, newest, 3 * sizeof *history);
}

/* Rows of a network's output on the whole state that are the body's. */
static int body_rows(const lts_model *m) {
  return m->motion == LTS_PREDICTED ? m->n_rigid : m->motion == LTS_DRIVEN;
}

/* Target of a node, or of the body as a whole (LTS_RIGID of a driven body), in the network's output. */
static double target_of(const lts_instance *soil, int node, int axis) {
  const lts_model *m = soil->model;
  if (!m->is_graph) {
    const int body = body_rows(m);
    const int row = node >= m->n_rigid ? body + node - m->n_rigid : body == 1 ? 0 : node;
    return soil->out[3 * row + axis];
  }
  if (m->motion != LTS_DRIVEN || node >= m->n_rigid) return soil->out[LTS_PANEL * node + axis];
  double mean = 0.0;
  for (int i = 0; i < m->n_rigid; ++i) mean += soil->out[LTS_PANEL * i + axis] / (double)m->n_rigid;
  return mean;
}

/* Share of its force that the body may show at `points`: 0 where it is clear of the soil about it. */
static double contact_share(const lts_instance *soil, const double *points) {
  const lts_model *m = soil->model;
  const float *modes = soil->state.offset + 3 * m->n_rigid;
  const int n_weight = 3 * m->n_modes;
  double clearance = HUGE_VAL;
  for (int p = 0; p < m->n_place; ++p) {
    const double *weights = m->place_weights + (size_t)p * n_weight;
    double height = m->place_heights[p];
    for (int k = 0; k < n_weight; ++k) height += weights[k] * modes[k];
    for (int i = 0; i < m->n_rigid; ++i) {
      const double apart = fabs(points[3 * i + m->way_axis] - m->places[p]);
      const double above = points[3 * i + m->up_axis] - height + m->clear_slope * apart;
      if (above < clearance) clearance = above;
    }
  }
  const double share = (m->clear + m->clear_ramp - clearance) / m->clear_ramp;
  return share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
}

static void read_force(lts_instance *soil, const double *points) {
  const lts_model *m = soil->model;
  const int n_node = lts_n_node(m);
  double *force = soil->state.head->result.force;
  for (int axis = 0; m->has_force && axis < 3; ++axis) {
    force[axis] = 0.0;
    if (!m->is_graph) {
      force[axis] = soil->out[3 * (body_rows(m) + m->n_modes) + axis];
      continue;
    }
    for (int i = 0; i < n_node; ++i) {
      force[axis] += (double)soil->out[LTS_PANEL * i + 3 + axis] / n_node;
    }
  }
  if (!m->n_place) return;
  const double share = contact_share(soil, points);
  for (int axis = 0; axis < 3; ++axis) force[axis] *= share;
}

static void move_modes(lts_instance *soil) {
  const lts_model *m = soil->model;
  for (int node = m->n_rigid; node < lts_n_node(m); ++node) {
    const float *last = last_velocity(soil, node);
    float v[3];
    for (int axis = 0; axis < 3; ++axis) {
      v[axis] = displacement_of(soil, node, axis, target_of(soil, node, axis), m->mode_order,
                                last[axis]);
      soil->state.offset[3 * node + axis] += v[axis];
    }
    push_velocity(soil, node, v);
  }
}

static void move_given_body(lts_instance *soil, const double *points) {
  const lts_model *m = soil->model;
  lts_head *head = soil->state.head;
  const int up = m->up_axis;
  if (m->motion == LTS_DRIVEN) {
    const float change = displacement_of(soil, 0, up, target_of(soil, 0, up), m->rigid_order,
                                         head->height_change[LTS_CHANGES - 1]);
    head->height += change;
    memmove(head->height_change, head->height_change + 1, (LTS_CHANGES - 1) * sizeof change);
    head->height_change[LTS_CHANGES - 1] = change;
  }
  const double height = lts_ungiven_height(m, points, m->origin);
  for (int i = 0; i < m->n_rigid; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      const double offset = points[3 * i + axis] - m->origin[3 * i + axis];
      soil->state.offset[3 * i + axis] = (float)(offset - (axis == up ? height : 0.0));
    }
    push_velocity(soil, i, soil->coming + 3 * i);
  }
  memcpy(soil->state.given, points, 3 * (size_t)m->n_rigid * sizeof *points);
}

/* Each particle of a predicted body, then the nearest rigid placement. `given` holds the predicted
 * points in between. */
static void move_predicted_body(lts_instance *soil) {
  const lts_model *m = soil->model;
  const int n = m->n_rigid;
  double *points = soil->state.given;
  for (int i = 0; i < n; ++i) {
    const float *last = last_velocity(soil, i);
    for (int axis = 0; axis < 3; ++axis) {
      const int j = 3 * i + axis;
      soil->coming[j] =
          displacement_of(soil, i, axis, target_of(soil, i, axis), m->rigid_order, last[axis]);
      points[j] = (double)(soil->state.offset[j] + soil->coming[j]) + m->origin[j];
    }
  }
  if (m->correction) lts_place_rigid(n, soil->state.shape, points, points);
  for (int i = 0; i < 3 * n; ++i) {
    const double offset = points[i] - m->origin[i];
    if (m->correction) soil->coming[i] = (float)(offset - (double)soil->state.offset[i]);
    soil->state.offset[i] = (float)offset;
  }
  for (int i = 0; i < n; ++i) push_velocity(soil, i, soil->coming + 3 * i);
}

int lts_frame(lts_instance *soil, const double *points, lts_result *result) {
  LTS_TRY(lts_check_started(soil));
  const lts_model *m = soil->model;
  lts_head *head = soil->state.head;
  if (lts_is_given(m) != (points != NULL)) return points ? LTS_ERROR_CALL : LTS_ERROR_NULL;
  for (int i = 0; points && i < 3 * m->n_rigid; ++i) {
    if (!isfinite(points[i])) return LTS_ERROR_VALUE;
  }
  if (head->frame == INT32_MAX) return LTS_ERROR_CALL; /* a year of frames */
  lts_prepare(soil);
  soil->rate = 1.0f;
  if (points) take_motion(soil, points);
  lts_network_now(soil);
  soil->prepared = 0;

  const int frame = ++head->frame;
  int status = points ? lts_check_given(soil, frame, soil->state.given, points) : 0;
  read_force(soil, points);
  move_modes(soil);
  if (points) move_given_body(soil, points);
  if (m->motion == LTS_PREDICTED) move_predicted_body(soil);
  status |= lts_check_predicted(soil, frame);
  lts_points(soil, soil->history);
  lts_centroid(soil->history, m->n_rigid, head->result.point);
  head->result.frame = frame;
  head->result.status = status;
  if (result) *result = head->result;
  return status;
}
