/* What a generated model file fills in. All arrays are row-major; [V] is R rigid points, then r modes.
 *
 * LayerNorm is folded: with h the last hidden layer of an MLP, its output is
 * f (h A + a) + o, where f = 1 / sqrt(|h T + t|^2 / width + epsilon) and T is triangular. Whatever
 * linear layer comes next is part of A, a and o.
 */
#ifndef LTS_MODEL_H
#define LTS_MODEL_H

#include "lts.h"

#define LTS_PANEL 16 /* columns of a weight panel */
#define LTS_PADDED(n) (((n) + LTS_PANEL - 1) / LTS_PANEL * LTS_PANEL)

/* y = x w + b. w is packed in panels of 16 columns, [panel][row][16], zero beyond the last column; of
 * a triangular matrix the panel p begins with row 16 p. */
typedef struct {
  int32_t rows, columns; /* columns: padded to whole panels */
  int32_t triangular, unused;
  const float *w, *b; /* b [columns] */
} lts_dense;

/* An MLP from the sum of its first layer to the factor f of its output. */
typedef struct {
  int32_t n_hidden, width;
  const lts_dense *hidden;
  lts_dense norm; /* T, t */
} lts_mlp;

/* f (h A + a) + o. */
typedef struct {
  lts_dense a;
  const float *o;
} lts_normed;

/* Linear functions of a node's latent that one message-passing step needs: first columns of each, or
 * -1. */
typedef struct {
  int32_t receive, send, update, decode, latent, total;
  lts_normed of; /* of the encoder's hidden layer in step 0; else a dense layer (o = null) of latents */
} lts_columns;

typedef struct {
  int32_t n_edge;    /* edges in use: the first so many */
  int32_t has_rigid; /* whether the step leaves rigid points behind */
  lts_mlp edge, node;
  lts_normed message;    /* latent of a message; unused in the last step */
  lts_dense next_edge;   /* first layer of the next step's edge model on the edge's latent */
  lts_dense received;    /* [sum f h, sum f, sum of weights] -> first layer of the node model */
  lts_normed change;     /* of the latent; in the last step of the decoder's first layer */
  lts_columns columns[2]; /* before the step: of rigid points, of modes */
} lts_step;

typedef struct {
  const double *modes;   /* [r][3] at rest */
  const double *points;  /* [R][3] of the body */
  const double *context; /* [C] */
} lts_start_data;

struct lts_model {
  int32_t abi, motion;
  const char *name, *digest, *context_names;
  int32_t n_rigid, n_modes, n_soil, n_context, n_start, up_axis;
  int32_t has_force, is_graph;
  int32_t position_inputs, knows_next, rate_scaled, correction; /* correction: keep a predicted body rigid */
  int32_t velocity_inputs, mode_order, rigid_order, has_log_context;
  int32_t has_height, n_place, way_axis; /* n_place 0: the force is shown wherever the body is */
  double dt, body_speed, rate_floor, height_std, height_velocity_std;
  /* Statistics of nodes, [V][3]. */
  const double *origin;
  const double *position_std, *velocity_mean, *velocity_std, *acceleration_mean, *acceleration_std;
  const double *target_mean, *target_std;
  const double *context_mean, *context_std, *log_context_mean, *log_context_std; /* [C] */
  /* Where the body is clear of the soil it shows no force: heights of the surface at places along
   * way_axis, linear in the offsets of the modes. */
  double clear, clear_ramp, clear_slope;
  const double *places;                   /* [P] m */
  const double *place_heights;            /* [P] m, at the modes' origin */
  const double *place_weights;            /* [P][r][3] */
  /* Least and most that is well, then the range of training: of nodes [4][V][3], of the given motion
   * [4][3] or [4][1], context [4][C], size of the force [4][1] (null: no limit is known). */
  const double *bounds, *start_range;
  const double *given_range, *given_velocity_range, *extent_range, *speed_range, *context_range;
  const double *force_range;
  /* Graph: edges sorted by how long they are needed. */
  int32_t n_edge, latent, n_feature, n_step;
  const int32_t *senders, *receivers;        /* [E] */
  const float *edge_scale, *edge_shift;      /* [E][3] */
  const float *node_bias;                    /* [V][latent, padded]: embedding and bias */
  int32_t mean_aggregation, n_decoder_hidden;
  lts_dense node_first, edge_first;          /* [features] and [displacement, length] -> latent */
  lts_mlp node_encoder, edge_encoder;
  lts_normed edge_out;                       /* first layer of the edge model, and the latent */
  const lts_step *steps;
  const lts_dense *decoder_hidden;
  lts_dense decoder_last;                    /* target [3], force [3] in N */
  /* Network on the whole state: ReLU layers, LayerNorm, [body, modes, force] out. */
  int32_t n_input, n_whole_hidden;
  const lts_dense *whole_hidden;
  lts_normed whole_out;
  float norm_epsilon, unused;
  /* Subspace, for offsets of the modes from their origin. */
  const float *components; /* [r][N, padded] */
  const float *mean;       /* [3][N, padded] */
  const lts_start_data *starts;
};

#endif
