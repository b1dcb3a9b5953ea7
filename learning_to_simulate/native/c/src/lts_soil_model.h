/* What a generated file of a soil field fills in. Letters and constants are those of `soil_field`: sweep.py,
 * place.py, passage.py, network.py. */
#ifndef LTS_SOIL_MODEL_H
#define LTS_SOIL_MODEL_H

#include "lts_model.h"
#include "lts_soil.h"

#define LTS_SOIL_MEMORIES 4
#define LTS_SOIL_MOTIONS 4  /* along, up, turn, pace */
#define LTS_SOIL_STRIPS 16  /* at most */
#define LTS_SOIL_SCALARS 40 /* of a frame, at most */
#define LTS_SOIL_AROUND 8   /* places about the tool at which the highest terrain is looked for, at most */

/* Channels of the bins of a frame; the last one, of the load only, is the ground of a neighbour: its surface
 * without its cut. */
enum {
  LTS_SOIL_CUT = 0, LTS_SOIL_SURFACE = 1, LTS_SOIL_SINCE = 2, LTS_SOIL_AREA_BEFORE = 3, LTS_SOIL_INFLUENCE = 4,
  LTS_SOIL_DISTURBED = 5, LTS_SOIL_STRUCK = 6, LTS_SOIL_BESIDE = 7
};
#define LTS_SOIL_CHANNELS 7
#define LTS_SOIL_UNDER_ALONG 11 /* places at which soil is looked for that has risen under a tool in the air */
#define LTS_SOIL_UNDER_ACROSS 5
#define LTS_SOIL_CONDITIONS 13  /* the last of what is judged */
#define LTS_SOIL_JUDGED_SPEED 3 /* where the speed is among what is judged */
#define LTS_SOIL_JUDGED_OWN 5   /* and from where on the tool's own numbers are */
/* Of the tool's numbers, those of its soil. */
#define LTS_SOIL_FRICTION 1
#define LTS_SOIL_STRESS(model) ((model)->n_own - 1)

/* Scalars of a frame that come from the path; then memories [LTS_SOIL_MEMORIES][LTS_SOIL_MOTIONS], those of the
 * tool, what is carried, how far below it the floor and ahead a wall is, what it can have left, how far behind it a
 * wall is, and (26). */
enum {
  LTS_SOIL_TIP = 0, LTS_SOIL_HEIGHT = 1, LTS_SOIL_LEAN = 2, LTS_SOIL_AREA = 3, LTS_SOIL_FOREMOST = 4,
  LTS_SOIL_WAY = 5, LTS_SOIL_SPEED = 6, LTS_SOIL_MEMORY = 7, LTS_SOIL_OWN = 23
};
/* Of those behind the tool's. */
enum {
  LTS_SOIL_CARRIED = 0, LTS_SOIL_BELOW = 1, LTS_SOIL_AHEAD = 2, LTS_SOIL_LAYER = 3, LTS_SOIL_BEHIND = 4,
  LTS_SOIL_PRESSED = 5
};
#define LTS_SOIL_OF_PASSAGE(model, scalar) (LTS_SOIL_OWN + (model)->n_own + LTS_SOIL_##scalar)

/* Tables of inputs that come with a model, see `soil_field/inputs.py`. */
#define LTS_STACK 8 /* values that an operand needs at once, at most */

/* First what puts a value on the stack: a scalar of the frame, a number, u, y or z of a particle, a channel at
 * that u or at an offset; then what takes two; then what takes one. */
enum {
  LTS_OP_SCALAR = 0, LTS_OP_NUMBER = 1, LTS_OP_REST = 2, LTS_OP_HERE = 3, LTS_OP_AT = 4,
  LTS_OP_ADD = 5, LTS_OP_SUB = 6, LTS_OP_ABS = 7, LTS_OP_RELU = 8, LTS_OP_SQRT = 9
};
enum {
  LTS_SQUASH_PLAIN = 0, LTS_SQUASH_TANH = 1, LTS_SQUASH_RELU = 2, LTS_SQUASH_RELU2 = 3, LTS_SQUASH_BELL = 4,
  LTS_SQUASH_FADE = 5
};
typedef struct {
  int32_t code, index;
  float value; /* a number, or an offset, m */
} lts_op;
typedef struct {
  int32_t first, count, squash; /* operations of the operand */
  float shift, scale;
} lts_row;
typedef struct {
  int32_t n_row, unused;
  const lts_row *rows;
  const lts_op *ops;
} lts_table;

/* Layers of M networks, each from the first to the last. */
typedef struct {
  int32_t n_layer, unused;
  const lts_dense *layers; /* [M][n_layer] */
} lts_soil_network;

struct lts_soil_model {
  int32_t abi, kind, n_member, unused;
  const char *digest, *judged_names;
  /* Bins: their spacing, how many lie behind the origin, where the tool stays about it, and by how many bins that
   * follows. */
  int32_t n_bin, n_behind, chunk, n_channel;
  double spacing, back, on;
  /* Sweep. */
  double window, forget, memories[4], touch, reach, rise, graze;
  /* Strips: under a tool, and on either side. */
  int32_t n_column, n_beside;
  double beside_width, across[5]; /* across: where a strip is read, in its widths */
  /* Tool and soil, see `tools.py`. */
  double taught_widths[2], rim, bucket_edge, floor_deg, floor_share, floor_falls, curl, lean_length;
  double standard_density, standard_gravity;
  /* Passage. */
  double ahead, below_tool, even, max_step, set_down, factor[2]; /* factor: of (20) */
  double flat, steep, relaid, even_slope;                        /* of a slope that is seen as level */
  /* m over the soil; under a tool along the way; behind its foremost place; over the terrain; way back that counts;
   * way of a passage. */
  double lifted, under, turned_back, strikes, backs, renewed_after;
  /* Payload, see `payload.py`. */
  double shell, arc, slips, slips_out, taken[2], curled[2];
  double taken_along[6], taken_across[5], falls_ahead, falls_apart;
  /* Terrain: of soil that slides. */
  int32_t slides, unused_slides;
  double slope_tolerance, slide_shares[3];
  /* Stepper. */
  double fastest, fastest_turn, turned, moved;
  /* Inputs. n_scalar: of a frame; n_own: of those of a tool, of which `radius` is one and the half width the
   * first; see_reach: m about the tool that the load and the status look at. */
  int32_t n_scalar, n_own, radius, n_around;
  double see_reach;
  lts_table load, side, here, particle, tool;
  /* Load, (10) to (12). */
  double under_along[11], under_across[5];
  float around[8];
  float heap, above, ramp, force, torque, full_width, gain_limit, unused_limit;
  /* Surface and particles, (13) to (15). */
  float stir, beside, beside_ramp, below, below_ramp, across_ramp, length, neighbour;
  /* Networks. The first layer of the load is done in two parts, own inputs of a strip and those of a neighbour,
   * all members side by side; `load` has the layers behind it. */
  lts_dense load_own, load_side;
  lts_soil_network after, surface, soil;
  /* Status: limits [4][n_judged], the least and the most that is well, then the range of training; middle
   * [n_judged] of that; the bit of each; how near to the tool bins are judged, how much
   * soil lies under it at least, how far other tools are, and how near it is judged what falls across, m. */
  int32_t n_judged, n_named; /* n_named: those that are scalars of a frame */
  const double *limits, *middle;
  const int32_t *bits;
  double judged_here, judged_near, least_soil, wall_beside, apart, crossed;
  double bound[3]; /* of the force: a constant (N of the field), of the spread, of the size; below 0: none */
};

#endif
