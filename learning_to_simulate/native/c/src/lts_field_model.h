/* What a generated file of a swept field fills in. Letters and constants are those of `tool/blade.py`,
 * `tool/wheel.py` and `network.py` of the method; lts_field_path.c and lts_field_wheel_path.c are their twins. */
#ifndef LTS_FIELD_MODEL_H
#define LTS_FIELD_MODEL_H

#include "lts_field.h"
#include "lts_model.h"
#include "lts_table.h"

#define LTS_FIELD_SCALES 4  /* memories of the velocity, at most */
#define LTS_FIELD_CONTEXT 8 /* values of a context, at most */
#define LTS_FIELD_CONDITIONS 7 /* that no network sees, see `swept_field/calibration.py` */

/* Channels of a frame's bins: of both tools, of a blade, of a wheel. */
enum {
  LTS_CUT = 0, LTS_SURFACE = 1, LTS_SINCE = 2, LTS_INFLUENCE = 3, LTS_DISTURBED = 4,
  LTS_AREA_BEFORE = 5,
  LTS_FIRST_CUT = 6, LTS_SLID = 7, LTS_SHEAR = 8, LTS_PEAK = 9
};
#define LTS_CHANNELS 10

/* Where a recorded wheel began. */
typedef struct {
  double radius, width;  /* m */
  const double *pose;    /* [7] */
  const double *context; /* [C] */
  const double *modes;   /* [n_mode][3] of its bed, m */
} lts_field_start_data;

struct lts_field_model {
  int32_t abi, tool, n_soil, n_member, n_scalar, unused_tool;
  int32_t axis, sign, up, turn; /* turn: sign of a torque across the way */
  const char *name, *digest, *scalar_names;
  double middle, dt;
  double level;        /* of the flat bed, m */
  const double *start; /* [3] see lts_field_description */
  /* Bins, and the circle that sweeps them. */
  int32_t n_bin, n_scale, n_pad, n_behind; /* n_pad: bins that a place around a particle is away;
                                            * n_behind: bins behind the tool's first place */
  double first, bin, radius, forget;
  const double *time_scales; /* [n_scale] */
  double touch, reach, rise, steep; /* steep: of a blade */
  /* Blade, bed, limits of a pose. */
  double width, blade_radius, length; /* of a wheel 0 */
  double kept_spacing, spacing, fastest, fastest_turn;
  const float *rest; /* [N][3] m */
  /* Beds of recorded wheels: mean + components modes. */
  int32_t n_context, n_start, n_mode, gravity, friction, load; /* the last three: columns of a context */
  const char *context_names;
  const lts_field_start_data *starts;
  const double *context_scale; /* [C] by which contexts are compared */
  const float *bed_mean;       /* [N][3] m */
  const float *bed_components; /* [N][n_mode] */
  /* Inputs: of a particle, of all particles of a frame, of the load. */
  lts_table own, shared, force_inputs;
  /* Shares of motion and contact; contact: [n] m about the tool. */
  int32_t n_contact, unused_contact;
  const float *contact;
  float below, below_ramp, beside, beside_ramp, across;
  float heap_height, contact_above, contact_ramp, first_bin, bin_width;
  float vertical, least_sunk; /* of a wheel */
  double stir, stir_load, borne;
  /* Networks. The inputs of a particle are its own [n_seen], then those that all share [n_shared]. */
  int32_t n_seen, n_shared, n_force, n_soil_hidden, n_load_hidden, latent, load_latent, unused;
  const lts_dense *soil_first;  /* [M] n_seen -> latent; biases come from soil_shared */
  const lts_dense *soil_hidden; /* [M][n_soil_hidden] */
  const lts_dense *soil_last;   /* [M] -> 3 */
  lts_dense soil_shared;        /* n_shared -> M latents side by side */
  lts_dense load_first;         /* n_force -> M latents side by side */
  const lts_dense *load_hidden; /* [M][n_load_hidden] */
  const lts_dense *load_last;   /* [M] -> 3, and the logarithm of their gain; of a wheel the height */
  float displacement, force, torque, full_width; /* units of what they say; of the width */
  float gain_limit, unused_limit;
  /* Status: limits [4][n_scalar + LTS_FIELD_CONDITIONS], the least and the most that is well, then the
   * range of training, and the bit of each; weights of the bound: constant, of the spread over members
   * and of the size of the force, or null. */
  double least_speed; /* m/s, below which a drift is a share of it */
  const double *limits;
  const int32_t *bits;
  const double *bound;
};

#endif
