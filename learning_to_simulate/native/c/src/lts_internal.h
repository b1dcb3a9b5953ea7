/* An instance: its state, which is saved and loaded, and the work space, which is not. */
#ifndef LTS_INTERNAL_H
#define LTS_INTERNAL_H

#include "lts_common.h"
#include "lts_kernels.h"

#define LTS_TILE_ROWS 48      /* rows that go through an MLP at once: they stay in the first cache */
#define LTS_CHANGES (LTS_HISTORY - 1)

enum { LTS_RIGID, LTS_MODES };                      /* kinds of nodes */
enum { LTS_WORSE_EXTRAPOLATING, LTS_WORSE_BOUNDS, LTS_WORSE_NON_FINITE, LTS_N_WORSE };

typedef struct {
  int32_t started; /* 0, or 1 + how: see below */
  int32_t start;   /* of lts_start; -1 of lts_reset, whose body has no pose */
  int32_t frame;   /* number of the newest frame */
  int32_t unused;
  double elapsed;  /* s since the newest frame, of lts_advance */
  lts_judgement worst[LTS_N_WORSE];
  lts_result result; /* of the newest frame */
  float height, height_change[LTS_CHANGES]; /* of a driven body, oldest change first, m */
} lts_head;

/* The arrays of a state follow its head: doubles, then floats. */
typedef struct {
  lts_head *head;
  double *context;  /* [C] */
  double *given;    /* [R][3] given points of the newest frame, m */
  double *shape;    /* [R][3] of a predicted body about its centroid, m */
  float *offset;    /* [V][3] from the origin, m; of a driven body without its height */
  float *velocity;  /* [V][K][3] last displacements, oldest first, m */
} lts_state;

struct lts_instance {
  uint32_t magic;
  int32_t kernel;
  const lts_model *model;
  const lts_kernels *run;
  lts_state state;
  int32_t prepared; /* whether the work space holds what lts_prepare computes */
  float rate;
  float *edges;    /* [E][latent, or twice: first layer, latent] */
  float *weight;   /* [E] share of a message in what its receiver takes */
  float *columns;  /* [V][columns] */
  float *received; /* [V][latent + 2, padded] */
  float *feature;  /* [V][features] or [inputs] */
  float *a, *b;    /* [tile][latent] rows on their way through an MLP */
  float *factor;   /* [tile] */
  float *out;      /* [V][16]: target, force; or the whole output */
  float *context_feature; /* [2 C] */
  float *coming;   /* [R][3] given displacement of the coming frame, m */
  double *history; /* [6][V][3] of a start, or the points of a pose */
};

/* Whether `soil` is an instance that has been started. */
int lts_check_started(const lts_instance *soil);

static inline int lts_n_node(const lts_model *m) { return m->n_rigid + m->n_modes; }
static inline int lts_is_given(const lts_model *m) {
  return m->motion == LTS_PRESCRIBED || m->motion == LTS_DRIVEN;
}

/* lts_network.c: target [V][3] in `out` columns 0 .. 2, force in 3 .. 5 of every node; of a network
 * on the whole state the rows of its output. */
void lts_network_ahead(lts_instance *soil);
void lts_network_now(lts_instance *soil);
int lts_column_stride(const lts_model *model); /* of `columns` */

/* lts_features.c */
int lts_needs_pose(const lts_model *model, int kind);
void lts_context_features(lts_instance *soil);
/* Of nodes [first, last) side by side, kind by kind: of one node, or of all. */
void lts_features(const lts_instance *soil, int first, int last, float *out);
void lts_node_offset(const lts_instance *soil, int node, float out[3]);

/* lts_status.c: checks of one frame of the start or of the rollout; return bits, and keep the first
 * frame of each kind. `before` is null for the first frame of all. */
int lts_check_context(lts_instance *soil, int frame);
int lts_check_start(lts_instance *soil, int frame, const double *nodes);
int lts_check_given(lts_instance *soil, int frame, const double *before, const double *points);
int lts_check_predicted(lts_instance *soil, int frame);

/* Mean height of the points of a driven body, which is not given, over those of `from` or
 * over 0; 0 of other bodies. */
double lts_ungiven_height(const lts_model *model, const double *points, const double *from);

/* lts_rigid.c */
void lts_place_rigid(int n, const double *shape, const double *predicted, double *placed);

#endif
