/* Memory, start, save and load. */
#include <math.h>
#include <string.h>

#include "lts_internal.h"

static int is_usable(const lts_model *model) { return model && model->abi == LTS_ABI; }

int lts_describe(const lts_model *model, lts_description *out) {
  if (!model || !out) return LTS_ERROR_NULL;
  if (!is_usable(model)) return LTS_ERROR_MODEL;
  const lts_description d = {model->abi,       model->n_rigid,   model->n_modes, model->n_soil,
                             model->n_context, model->n_start,   model->motion,  model->has_force,
                             model->up_axis,   model->dt,        model->name,    model->digest,
                             model->context_names};
  *out = d;
  return LTS_OK;
}

/* Walks the arrays of a state; `base` may be null, to count. */
static size_t lay_out_state(const lts_model *m, char *base, lts_state *state) {
  const size_t n_node = (size_t)lts_n_node(m), n_rigid = (size_t)m->n_rigid;
  size_t at = 0;
  LTS_TAKE(state->head, lts_head, 1, 8);
  LTS_TAKE(state->context, double, (size_t)m->n_context, 8);
  LTS_TAKE(state->given, double, 3 * n_rigid, 8);
  LTS_TAKE(state->shape, double, m->correction ? 3 * n_rigid : 0, 8);
  LTS_TAKE(state->offset, float, 3 * n_node, 8);
  LTS_TAKE(state->velocity, float, 3 * n_node * (size_t)m->velocity_inputs, 8);
  return at;
}

static size_t state_bytes(const lts_model *model) { return lay_out_state(model, NULL, NULL); }

/* Sizes in one place: both lts_size and lts_init walk the same list. */
static size_t lay_out(const lts_model *m, char *base, lts_instance *soil) {
  const size_t n_node = (size_t)lts_n_node(m), tile = LTS_TILE_ROWS;
  const size_t latent = (size_t)LTS_PADDED(m->latent);
  size_t width = latent, out = LTS_PANEL * n_node;
  for (int i = 0; i < m->n_whole_hidden; ++i) {
    const size_t n = (size_t)m->whole_hidden[i].columns;
    width = n > width ? n : width;
  }
  if (!m->is_graph) out = (size_t)m->whole_out.a.columns;
  const size_t n_feature = m->is_graph ? n_node * (size_t)m->n_feature : (size_t)m->n_input;
  size_t at = lts_aligned(sizeof(lts_instance), LTS_ALIGNMENT);
  if (base) lay_out_state(m, base + at, &soil->state);
  at += lts_aligned(state_bytes(m), LTS_ALIGNMENT);
  LTS_TAKE(soil->history, double, LTS_HISTORY * 3 * n_node, LTS_ALIGNMENT);
#define TAKE(field, count) LTS_TAKE(soil->field, float, count, LTS_ALIGNMENT);
  TAKE(edges, (size_t)m->n_edge * (m->n_step > 1 ? 2 : 1) * latent)
  TAKE(weight, (size_t)m->n_edge)
  TAKE(columns, n_node * (size_t)lts_column_stride(m))
  TAKE(received, m->is_graph ? n_node * (latent + LTS_PANEL) : 0)
  TAKE(feature, n_feature)
  TAKE(a, m->is_graph ? tile * width : width)
  TAKE(b, m->is_graph ? tile * width : width)
  TAKE(factor, tile)
  TAKE(out, out)
  TAKE(context_feature, 2 * (size_t)m->n_context)
  TAKE(coming, 3 * (size_t)m->n_rigid)
#undef TAKE
  return at;
}

size_t lts_size(const lts_model *model) {
  return is_usable(model) ? lay_out(model, NULL, NULL) + LTS_ALIGNMENT - 1 : 0;
}

int lts_init(const lts_model *model, void *memory, size_t size, int kernel, lts_instance **out) {
  if (!model || !memory || !out) return LTS_ERROR_NULL;
  if (!is_usable(model)) return LTS_ERROR_MODEL;
  if (size < lts_size(model)) return LTS_ERROR_MEMORY;
  int found = 0;
  const lts_kernels *run = lts_find_kernels(kernel, &found);
  if (!run) return LTS_ERROR_VALUE;
  lts_instance *soil = lts_cleared(memory, lay_out(model, NULL, NULL));
  lay_out(model, (char *)soil, soil);
  soil->model = model;
  soil->run = run;
  soil->kernel = found;
  soil->magic = LTS_MAGIC;
  *out = soil;
  return LTS_OK;
}

int lts_kernel(const lts_instance *soil) {
  LTS_TRY(lts_check(soil));
  return soil->kernel;
}

int lts_reset(lts_instance *soil, const double *history, const double *context) {
  LTS_TRY(lts_check(soil));
  const lts_model *m = soil->model;
  const size_t n_node = (size_t)lts_n_node(m), n_rigid = (size_t)m->n_rigid;
  if (!history || (m->n_context && !context)) return LTS_ERROR_NULL;
  if (!lts_all_finite(history, LTS_HISTORY * 3 * n_node)) return LTS_ERROR_VALUE;
  if (m->n_context && !lts_all_finite(context, (size_t)m->n_context)) return LTS_ERROR_VALUE;
  lts_state *s = &soil->state;
  lts_head *head = s->head;
  memset(head, 0, state_bytes(m));
  soil->prepared = 0;
  head->started = 1;
  head->start = -1;
  head->frame = LTS_HISTORY - 1;
  for (int i = 0; i < LTS_N_WORSE; ++i) head->worst[i].frame = -1;
  for (int i = 0; i < m->n_context; ++i) s->context[i] = context[i];

  const int count = m->velocity_inputs, up = m->up_axis, driven = m->motion == LTS_DRIVEN;
  const double *newest = history + (LTS_HISTORY - 1) * 3 * n_node;
  double heights[LTS_HISTORY] = {0}, rise = 0.0;
  for (int f = 0; driven && f < LTS_HISTORY; ++f) {
    for (size_t i = 0; i < n_rigid; ++i) heights[f] += history[(f * n_node + i) * 3 + up];
    heights[f] /= (double)n_rigid;
  }
  for (size_t i = 0; driven && i < n_rigid; ++i) rise += m->origin[3 * i + up];
  for (size_t i = 0; i < n_node; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      const int is_height = driven && i < n_rigid && axis == up;
      double offset = newest[3 * i + axis] - m->origin[3 * i + axis];
      /* As in the model: the mean over the points of their offsets is the height. */
      if (is_height) offset -= heights[LTS_HISTORY - 1] - rise / (double)n_rigid;
      s->offset[3 * i + axis] = (float)offset;
      for (int k = 0; k < count; ++k) {
        const int f = LTS_HISTORY - count + k;
        const double *at = history + (f * n_node + i) * 3 + axis;
        double velocity = at[0] - at[-(ptrdiff_t)(3 * n_node)];
        if (is_height) velocity -= heights[f] - heights[f - 1];
        s->velocity[(i * count + k) * 3 + axis] = (float)velocity;
      }
    }
  }
  if (driven) {
    head->height = (float)(heights[LTS_HISTORY - 1] - rise / (double)n_rigid);
    for (int k = 0; k < LTS_CHANGES; ++k) {
      head->height_change[k] = (float)(heights[k + 1] - heights[k]);
    }
  }
  if (n_rigid) memcpy(s->given, newest, 3 * n_rigid * sizeof *newest);
  if (m->correction) {
    double centroid[3];
    for (size_t i = 0; i < 3 * n_rigid; ++i) s->shape[i] = (double)s->offset[i] + m->origin[i];
    lts_centroid(s->shape, m->n_rigid, centroid);
    for (size_t i = 0; i < 3 * n_rigid; ++i) s->shape[i] -= centroid[i % 3];
  }
  lts_context_features(soil);
  int status = lts_check_context(soil, 0);
  for (int f = 0; f < LTS_HISTORY; ++f) {
    const double *nodes = history + f * 3 * n_node;
    status |= lts_check_start(soil, f, nodes);
    if (lts_is_given(m)) status |= lts_check_given(soil, f, f ? nodes - 3 * n_node : NULL, nodes);
  }
  head->result.frame = head->frame;
  head->result.status = status;
  lts_centroid(newest, m->n_rigid, head->result.point);
  return status;
}

int lts_set_context(lts_instance *soil, const double *context) {
  LTS_TRY(lts_check_started(soil));
  const lts_model *m = soil->model;
  if (!m->n_context) return LTS_ERROR_CALL;
  if (!context) return LTS_ERROR_NULL;
  if (!lts_all_finite(context, (size_t)m->n_context)) return LTS_ERROR_VALUE;
  if (soil->state.head->frame == INT32_MAX) return LTS_ERROR_CALL; /* no frame comes */
  for (int i = 0; i < m->n_context; ++i) soil->state.context[i] = context[i];
  soil->prepared = 0;
  lts_context_features(soil);
  return lts_check_context(soil, soil->state.head->frame + 1);
}

size_t lts_state_size(const lts_model *model) {
  return is_usable(model) ? LTS_HEADER_SIZE + state_bytes(model) : 0;
}

int lts_save(const lts_instance *soil, void *bytes, size_t size) {
  LTS_TRY(lts_check(soil));
  const lts_model *m = soil->model;
  return lts_write_state(m->digest, soil->state.head, state_bytes(m), bytes, size);
}

int lts_load(lts_instance *soil, const void *bytes, size_t size) {
  LTS_TRY(lts_check(soil));
  const lts_model *m = soil->model;
  const size_t n = state_bytes(m);
  lts_head head;
  LTS_TRY(lts_check_state(m->digest, bytes, size, n));
  const char *state = (const char *)bytes + LTS_HEADER_SIZE;
  memcpy(&head, state, sizeof head);
  /* A checksum can be forged: the index and the clock are what could lead astray. */
  if (head.start < -1 || head.start >= m->n_start) return LTS_ERROR_STATE;
  if (!(fabs(head.elapsed) <= 2.0 * m->dt)) return LTS_ERROR_STATE;
  memcpy(soil->state.head, state, n);
  soil->prepared = 0;
  if (head.started) lts_context_features(soil);
  return LTS_OK;
}

int lts_clone(lts_instance *to, const lts_instance *from) {
  LTS_TRY(lts_check(to));
  LTS_TRY(lts_check(from));
  if (to->model != from->model) return LTS_ERROR_STATE;
  if (to == from) return LTS_OK;
  memcpy(to->state.head, from->state.head, state_bytes(to->model));
  to->prepared = 0;
  if (to->state.head->started) lts_context_features(to);
  return LTS_OK;
}
