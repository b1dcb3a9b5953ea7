/* Soil under a blade whose path is given, or under a driven wheel whose turn, travel and load are, from
 * what it has swept: the C interface of an exported swept field. Memory, errors, units and threads are as in lts.h; nothing is integrated over time, so a step
 * may last any time and has no frames to wait for. There is nothing to prepare: a force needs its pose.
 *
 *   lts_field_init(&lts_model_of_export, memory, size, LTS_BEST, &soil);
 *   lts_field_start(soil, &pose, NULL, NULL, 0.0);            // on the flat bed of the training
 *   for (;;) {
 *     lts_field_frame(soil, &pose, dt, &result);        // force, torque, bound; no particle
 *     lts_field_particles(soil, particles, n);          // only where they are asked for
 *   }
 */
#ifndef LTS_FIELD_H
#define LTS_FIELD_H

#include "lts.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct lts_field_model lts_field_model;
typedef struct lts_field lts_field;

/* What drives through the soil. */
enum { LTS_FIELD_BLADE = 0, LTS_FIELD_WHEEL = 1 };

typedef struct {
  int32_t abi;
  int32_t n_soil;   /* N particles */
  int32_t n_member; /* M networks whose mean answers and whose spread says how sure it is */
  int32_t n_scalar; /* measures of a frame that a status is judged by */
  int32_t up_axis;
  int32_t travel_axis; /* the tool drives along this axis of the world, */
  int32_t travel_sign; /* this way */
  int32_t has_bound;   /* whether the spread was calibrated */
  int32_t tool;        /* LTS_FIELD_BLADE or LTS_FIELD_WHEEL */
  int32_t n_context;   /* C values of a wheel's scene; 0 of a blade */
  int32_t n_start;     /* recorded starts of wheels; 0 of a blade */
  int32_t roll_sign;   /* of an angular velocity across the way with which a wheel rolls on */
  int32_t load;        /* which value of the context is the load of a wheel, N; it may change */
  double dt;           /* s between the frames of training; any other will do */
  double blade_width, blade_radius, blade_length; /* m; the radius is of the round lower edge; of a wheel 0 */
  double floor, level;         /* of the flat bed, m */
  double start[3];             /* a place to begin at: over the flat bed, clear of it; the first start
                                * of a wheel; m */
  const char *name;            /* of the scene */
  const char *digest;          /* sha256 of all numbers of the model, hexadecimal */
  const char *scalar_names;    /* separated by commas */
  const char *context_names;   /* separated by commas */
} lts_field_description;

/* A bed: heights along the way, the same across it, or all particles. */
typedef struct {
  const double *places;  /* [n] on the world's axis of travel, rising, m */
  const double *heights; /* [n] m */
  int32_t n;             /* at least 2; 0 for particles */
  const float *particles; /* [N][3] m; needed where n is 0 */
} lts_field_bed;

typedef struct {
  double force[3];    /* on the tool, N */
  double torque[3];   /* about `point`, N m */
  double point[3];    /* the tool's reference point, m: the middle of a blade's lower edge; the axle of a
                       * wheel, with the height that was predicted */
  double force_bound; /* N, root mean square per component, kept by 95 % of frames like those of the
                       * validation runs; 0 where the model was not calibrated */
  int32_t frame;      /* steps since the start */
  int32_t status;     /* LTS_OUTSIDE_POSE (also turned or beside the middle), _SPEED (also
                       * across, and too long a step), _START (the bed), _CONTEXT or LTS_NON_FINITE */
} lts_field_result;

LTS_API int lts_field_describe(const lts_field_model *model, lts_field_description *out);

/* Bytes that an instance needs, at any address; 0 for no usable model. */
LTS_API size_t lts_field_size(const lts_field_model *model);
LTS_API int lts_field_init(const lts_field_model *model, void *memory, size_t size, int kernel,
                           lts_field **out);
LTS_API int lts_field_kernel(const lts_field *soil);
/* How many of the networks answer, 1 .. M, for force and for particles; all of them at first. Fewer are
 * faster; what was measured is the mean of all. */
LTS_API int lts_field_members(lts_field *soil, int of_force, int of_particles);

/* Begins where the blade is; a wheel has lts_field_start_wheel.
 *   pose: the middle of the blade's lower edge, and its rotation from upright.
 *   twist: its motion so far; null: at rest.
 *   bed: null for the flat bed of the training.
 *   blade_width: m; 0 for the usual one. */
LTS_API int lts_field_start(lts_field *soil, const lts_pose *pose, const lts_twist *twist,
                            const lts_field_bed *bed, double blade_width);
/* Begins where a recorded wheel did, standing in its own print: it has no other bed to begin on.
 *   start: 0 .. n_start - 1; -1 takes the one whose context is nearest, or the first.
 *   pose: of the axle; null: that of the start. The height counts, here only.
 *   twist: its motion so far; null: at rest.
 *   bed: null for that of the start.
 *   context: [C]; null: that of the start. */
LTS_API int lts_field_start_wheel(lts_field *soil, int start, const lts_pose *pose,
                                  const lts_twist *twist, const lts_field_bed *bed,
                                  const double *context);
/* Pose and context [C] of a start. */
LTS_API int lts_field_start_pose(const lts_field_model *model, int start, lts_pose *out);
LTS_API int lts_field_start_context(const lts_field_model *model, int start, double *context);
/* Context [C] of the coming step and those after it; only the load may change. */
LTS_API int lts_field_set_context(lts_field *soil, const double *context);
LTS_API int lts_field_context(const lts_field *soil, double *context);
/* Begins anew where the tool is, on the bed as the model now sees it: for use without end. */
LTS_API int lts_field_renew(lts_field *soil);

/* Moves the tool in a straight line to its next pose in `dt` seconds; the height of a wheel's pose is
 * ignored. result may be null. Refuses a jump, a place under the floor or beyond the bins. */
LTS_API int lts_field_frame(lts_field *soil, const lts_pose *pose, double dt,
                            lts_field_result *result);
/* The newest result; after a start without a load. */
LTS_API int lts_field_newest(const lts_field *soil, lts_field_result *result);
/* A step of `h` seconds, of which `pose` and `twist` hold at the beginning. */
LTS_API int lts_field_advance(lts_field *soil, double h, const lts_pose *pose,
                              const lts_twist *twist, lts_field_result *result);

/* Soil particles [N][3] now, m; none of them inside the tool. `count` is N. */
LTS_API int lts_field_particles(lts_field *soil, float *out, size_t count);
/* How many of them may have moved; the others are left out, exactly. */
LTS_API int lts_field_moving(lts_field *soil);
/* As lts_height_map. */
LTS_API int lts_field_height_map(lts_field *soil, const lts_grid *grid, float *out);

/* The first measure that leaves its training range in the newest frame: `axis` is its number, `node`
 * is -1. */
LTS_API int lts_field_judge(const lts_field *soil, lts_judgement *out);
/* The same in words, as lts_reason. */
LTS_API int lts_field_reason(const lts_field *soil, char *text, size_t size);

/* State as bytes. It is larger by the particles (12 N) where a bed was given, and for every wheel. */
LTS_API size_t lts_field_state_size(const lts_field *soil);
LTS_API int lts_field_save(const lts_field *soil, void *bytes, size_t size);
LTS_API int lts_field_load(lts_field *soil, const void *bytes, size_t size);
LTS_API int lts_field_clone(lts_field *to, const lts_field *from);

#ifdef __cplusplus
}
#endif

#endif
