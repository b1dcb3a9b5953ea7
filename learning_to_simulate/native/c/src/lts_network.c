/* The networks. A graph network is split into what needs no pose of the coming frame (ahead) and the
 * rest (now); see lts_model.h for how LayerNorm is folded. */
#include <math.h>
#include <string.h>

#include "lts_internal.h"

static int first_node(const lts_model *m, int kind) { return kind == LTS_RIGID ? 0 : m->n_rigid; }
static int n_node_of(const lts_model *m, int kind) {
  return kind == LTS_RIGID ? m->n_rigid : m->n_modes;
}
static int smaller(int a, int b) { return a < b ? a : b; }

/* Rows of a latent's width from x to y, of row stride ldy. */
static void dense(const lts_instance *soil, const lts_dense *layer, const float *x, int ldx, int rows,
                  float *y, int ldy, lts_form form) {
  soil->run->dense(layer, x, ldx, rows, y, ldy, form, NULL, NULL);
}

static void swap_rows(lts_instance *soil) {
  float *other = soil->a;
  soil->a = soil->b;
  soil->b = other;
}

/* From the rectified first layer in `a` [rows][latent] to the last hidden layer, again in `a`, and the
 * factor of each row. */
static void run_mlp(lts_instance *soil, const lts_mlp *mlp, int rows) {
  const int stride = LTS_PADDED(soil->model->latent);
  for (int i = 0; i < mlp->n_hidden; ++i) {
    dense(soil, &mlp->hidden[i], soil->a, stride, rows, soil->b, stride, LTS_RELU);
    swap_rows(soil);
  }
  dense(soil, &mlp->norm, soil->a, stride, rows, soil->factor, 1, LTS_SQUARES);
  for (int i = 0; i < rows; ++i) {
    soil->factor[i] = 1.0f / sqrtf(soil->factor[i] / (float)mlp->width + soil->model->norm_epsilon);
  }
}

static void run_normed(lts_instance *soil, const lts_normed *layer, int rows, float *y, int ldy) {
  soil->run->dense(&layer->a, soil->a, LTS_PADDED(soil->model->latent), rows, y, ldy, LTS_NORMED,
                   soil->factor, layer->o);
}

static int edge_stride(const lts_model *m) {
  return LTS_PADDED(m->latent) * (m->n_step > 1 ? 2 : 1);
}

int lts_column_stride(const lts_model *m) {
  int stride = 0;
  for (int i = 0; i < 2 * m->n_step; ++i) {
    const int total = m->steps[i / 2].columns[i % 2].total;
    stride = total > stride ? total : stride;
  }
  return stride;
}

/* Share of each message: a mean over the edges of its receiver, or their sum. */
static void weigh_edges(lts_instance *soil) {
  const lts_model *m = soil->model;
  float *degree = soil->received; /* free until messages are received */
  for (int i = 0; i < lts_n_node(m); ++i) degree[i] = 0.0f;
  for (int e = 0; e < m->n_edge; ++e) degree[m->receivers[e]] += 1.0f;
  for (int e = 0; e < m->n_edge; ++e) {
    soil->weight[e] = m->mean_aggregation ? 1.0f / degree[m->receivers[e]] : 1.0f;
  }
}

static void encode_edges(lts_instance *soil) {
  const lts_model *m = soil->model;
  const int stride = LTS_PADDED(m->latent);
  float feature[LTS_TILE_ROWS][4];
  weigh_edges(soil);
  for (int first = 0; first < m->n_edge; first += LTS_TILE_ROWS) {
    const int rows = smaller(LTS_TILE_ROWS, m->n_edge - first);
    for (int i = 0; i < rows; ++i) {
      const int e = first + i;
      float from[3], to[3], square = 0.0f;
      lts_node_offset(soil, m->senders[e], from);
      lts_node_offset(soil, m->receivers[e], to);
      for (int axis = 0; axis < 3; ++axis) {
        const int j = 3 * e + axis;
        feature[i][axis] = (from[axis] - to[axis]) * m->edge_scale[j] + m->edge_shift[j];
        square += feature[i][axis] * feature[i][axis];
      }
      feature[i][3] = sqrtf(square < 1e-12f ? 1e-12f : square);
    }
    dense(soil, &m->edge_first, feature[0], 4, rows, soil->a, stride, LTS_RELU);
    run_mlp(soil, &m->edge_encoder, rows);
    run_normed(soil, &m->edge_out, rows, soil->edges + (size_t)first * edge_stride(m),
               edge_stride(m));
  }
}

static void encode_nodes(lts_instance *soil, int kind) {
  const lts_model *m = soil->model;
  const int stride = LTS_PADDED(m->latent), ldc = lts_column_stride(m), n = n_node_of(m, kind);
  const lts_columns *columns = &m->steps[0].columns[kind];
  if (!columns->total) return;
  for (int done = 0; done < n; done += LTS_TILE_ROWS) {
    const int rows = smaller(LTS_TILE_ROWS, n - done), first = first_node(m, kind) + done;
    float *feature = soil->feature + (size_t)first * m->n_feature;
    for (int i = 0; i < rows; ++i) {
      lts_features(soil, first + i, first + i + 1, feature + i * m->n_feature);
    }
    dense(soil, &m->node_first, feature, m->n_feature, rows, soil->b, stride, LTS_NORMED);
    soil->run->sum_relu(soil->b, m->node_bias + (size_t)first * stride, NULL, rows * stride, soil->a);
    run_mlp(soil, &m->node_encoder, rows);
    run_normed(soil, &columns->of, rows, soil->columns + (size_t)first * ldc, ldc);
  }
}

static void pass_messages(lts_instance *soil, int index) {
  const lts_model *m = soil->model;
  const lts_step *step = &m->steps[index];
  const int stride = LTS_PADDED(m->latent), ldc = lts_column_stride(m), lde = edge_stride(m);
  const int ldr = stride + LTS_PANEL, n_kept = index + 1 < m->n_step ? m->steps[index + 1].n_edge : 0;
  memset(soil->received, 0, (size_t)lts_n_node(m) * ldr * sizeof *soil->received);
  for (int first = 0; first < step->n_edge; first += LTS_TILE_ROWS) {
    const int rows = smaller(LTS_TILE_ROWS, step->n_edge - first);
    for (int i = 0; i < rows; ++i) {
      const int s = m->senders[first + i], r = m->receivers[first + i];
      const lts_columns *sender = &step->columns[s < m->n_rigid ? LTS_RIGID : LTS_MODES];
      const lts_columns *receiver = &step->columns[r < m->n_rigid ? LTS_RIGID : LTS_MODES];
      soil->run->sum_relu(soil->edges + (size_t)(first + i) * lde,
                          soil->columns + (size_t)r * ldc + receiver->receive,
                          soil->columns + (size_t)s * ldc + sender->send, stride,
                          soil->a + i * stride);
    }
    run_mlp(soil, &step->edge, rows);
    for (int i = 0; i < rows; ++i) {
      const int e = first + i;
      const float share = soil->weight[e] * soil->factor[i];
      float *to = soil->received + (size_t)m->receivers[e] * ldr;
      soil->run->accumulate(share, soil->a + i * stride, stride, to);
      to[m->latent] += share; /* beyond the last hidden value, which a padded row leaves free */
      to[m->latent + 1] += soil->weight[e];
    }
    const int keep = smaller(rows, n_kept - first);
    if (keep > 0) {
      float *edges = soil->edges + (size_t)first * lde;
      run_normed(soil, &step->message, keep, soil->b, stride);
      for (int i = 0; i < keep; ++i) {
        soil->run->accumulate(1.0f, soil->b + i * stride, stride, edges + (size_t)i * lde + stride);
      }
      dense(soil, &step->next_edge, edges + stride, lde, keep, edges, lde, LTS_NORMED);
    }
  }
}

/* From the first layer of the decoder, rectified in `a`, to its outputs. */
static void decode(lts_instance *soil, int first, int rows) {
  const lts_model *m = soil->model;
  const int stride = LTS_PADDED(m->latent);
  for (int i = 0; i < m->n_decoder_hidden; ++i) {
    dense(soil, &m->decoder_hidden[i], soil->a, stride, rows, soil->b, stride, LTS_RELU);
    swap_rows(soil);
  }
  dense(soil, &m->decoder_last, soil->a, stride, rows, soil->out + first * LTS_PANEL, LTS_PANEL, LTS_NORMED);
}

static void update_nodes(lts_instance *soil, int index, int kind) {
  const lts_model *m = soil->model;
  const lts_step *step = &m->steps[index];
  const lts_columns *columns = &step->columns[kind];
  const int stride = LTS_PADDED(m->latent), ldc = lts_column_stride(m), ldr = stride + LTS_PANEL;
  const int n = n_node_of(m, kind), is_last = index + 1 == m->n_step;
  for (int done = 0; done < n; done += LTS_TILE_ROWS) {
    const int rows = smaller(LTS_TILE_ROWS, n - done), first = first_node(m, kind) + done;
    float *of_nodes = soil->columns + (size_t)first * ldc;
    /* A kind without edges into it receives nothing. */
    const float *received = columns->receive < 0 ? NULL : soil->received + (size_t)first * ldr;
    if (received) dense(soil, &step->received, received, ldr, rows, soil->b, stride, LTS_NORMED);
    for (int i = 0; i < rows; ++i) {
      soil->run->sum_relu(of_nodes + (size_t)i * ldc + columns->update,
                          received ? soil->b + i * stride : NULL, NULL, stride, soil->a + i * stride);
    }
    run_mlp(soil, &step->node, rows);
    run_normed(soil, &step->change, rows, soil->b, stride);
    if (is_last) {
      for (int i = 0; i < rows; ++i) {
        soil->run->sum_relu(of_nodes + (size_t)i * ldc + columns->decode, soil->b + i * stride, NULL,
                            stride, soil->a + i * stride);
      }
      decode(soil, first, rows);
      continue;
    }
    /* The latent goes into `b`, because the columns of the next step lie where it is now. */
    const lts_columns *next = &m->steps[index + 1].columns[kind];
    for (int i = 0; i < rows; ++i) {
      soil->run->accumulate(1.0f, of_nodes + (size_t)i * ldc + columns->latent, stride,
                            soil->b + i * stride);
    }
    dense(soil, &next->of.a, soil->b, stride, rows, of_nodes, ldc, LTS_NORMED);
    for (int i = 0; next->latent >= 0 && i < rows; ++i) {
      memcpy(of_nodes + (size_t)i * ldc + next->latent, soil->b + i * stride, (size_t)stride * sizeof(float));
    }
  }
}

static void process(lts_instance *soil) {
  const lts_model *m = soil->model;
  for (int i = 0; i < m->n_step; ++i) {
    pass_messages(soil, i);
    update_nodes(soil, i, LTS_MODES);
    if (m->steps[i].has_rigid) update_nodes(soil, i, LTS_RIGID);
  }
}

static void run_whole(lts_instance *soil) {
  const lts_model *m = soil->model;
  lts_features(soil, 0, lts_n_node(m), soil->feature);
  const float *x = soil->feature;
  for (int i = 0; i < m->n_whole_hidden; ++i) {
    dense(soil, &m->whole_hidden[i], x, 0, 1, soil->b, 0, LTS_RELU);
    swap_rows(soil);
    x = soil->a;
  }
  const int n = m->whole_out.a.rows;
  double mean = 0.0, square = 0.0;
  for (int i = 0; i < n; ++i) mean += x[i];
  mean /= n;
  for (int i = 0; i < n; ++i) square += (x[i] - mean) * (x[i] - mean);
  soil->factor[0] = (float)(1.0 / sqrt(square / n + m->norm_epsilon));
  soil->run->dense(&m->whole_out.a, x, 0, 1, soil->out, 0, LTS_NORMED, soil->factor,
                   m->whole_out.o);
}

void lts_network_ahead(lts_instance *soil) {
  const lts_model *m = soil->model;
  if (!m->is_graph) return;
  encode_edges(soil);
  if (!m->rate_scaled) soil->rate = 1.0f;
  for (int kind = 0; kind < 2; ++kind) {
    if (!lts_needs_pose(m, kind)) encode_nodes(soil, kind);
  }
  if (!lts_needs_pose(m, LTS_RIGID) && !lts_needs_pose(m, LTS_MODES)) process(soil);
}

void lts_network_now(lts_instance *soil) {
  const lts_model *m = soil->model;
  if (!m->is_graph) {
    run_whole(soil);
    return;
  }
  for (int kind = 0; kind < 2; ++kind) {
    if (lts_needs_pose(m, kind)) encode_nodes(soil, kind);
  }
  if (lts_needs_pose(m, LTS_RIGID) || lts_needs_pose(m, LTS_MODES)) process(soil);
}
