/* A tool anywhere on a terrain, from what it has swept: the C interface of a soil field. Memory, errors,
 * units and kernels are as in lts.h. The world has y up; x and z lie on the ground. Nothing is integrated over
 * time, so a step may last any time.
 *
 *   lts_terrain ground = {heights, {600, 150}, 0, 0, {0.0, 0.0}, {0.02, 0.02}, -1.0, 37.2348, 1730.61, 9.81, 0};
 *   lts_soil_tool blade = {.width = 0.457, .radius = 0.014, .length = 0.277};
 *   lts_soil_init(&lts_model_of_export, &blade, &ground, memory, size, LTS_BEST, &soil);
 *   lts_soil_start(soil, &pose, &result);
 *   for (;;) {
 *     lts_soil_step(soil, &pose, dt, &result);      // force, torque, status
 *     lts_terrain_update(&ground);                  // only where heights are looked at
 *   }
 *   lts_soil_close(soil);
 *
 * Several tools may work on one terrain, each with an instance of its own; each meets what the others have left.
 * A terrain and its tools may be used by one thread at a time.
 */
#ifndef LTS_SOIL_H
#define LTS_SOIL_H

#include "lts.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct lts_soil_model lts_soil_model;
typedef struct lts_soil lts_soil;

/* What drives through the soil. */
enum { LTS_SOIL_BLADE = 0, LTS_SOIL_WHEEL = 1 };

/* The ground: heights of cells, and what it consists of. It must stay where it is as long as tools work on it;
 * of its fields only the heights may change. */
typedef struct {
  double *heights;   /* [n[0]][n[1]] m at the middles of the cells; may be written into between calls */
  int32_t n[2];      /* cells along x and z */
  int32_t walled;    /* whether the border is a wall, as that of a bin */
  int32_t unused;
  double corner[2];  /* lowest x and z of the map, m */
  double cell[2];    /* sides of a cell, m */
  double floor;      /* below it there is no soil, m */
  double friction_angle_deg, density, gravity; /* of the soil: degrees, kg/m3, m/s2 */
  lts_soil *first;   /* of the tools on it; null at first */
} lts_terrain;

/* A tool. The pose of a blade is that of the middle of its lower edge, of a wheel that of the middle of its
 * axle; with the identity as its quaternion it stands upright and looks along -x. */
typedef struct {
  double width, radius;          /* across the way; of the lower edge, or of the rim between grousers; m */
  double length, bucket, plates; /* of a blade: height of the outline, m; 1 of a shell that is open to the front; 1
                                  * where its ends are closed */
  double floor_deg, floor_share; /* of a bucket: by how much its underside rises behind the edge, degrees (7 is
                                  * usual); length of that over the height (0.6) */
  double lugs, lug_height;       /* of a wheel: number and height (m) of its grousers */
} lts_soil_tool;

typedef struct {
  int32_t abi;
  int32_t kind;      /* LTS_SOIL_BLADE or LTS_SOIL_WHEEL */
  int32_t n_member;  /* M networks whose mean answers */
  int32_t n_bin;     /* along the way */
  int32_t n_channel, n_scalar; /* of a frame, see lts_soil_see */
  int32_t n_judged;  /* measures that a status is judged by */
  int32_t unused;
  const char *digest;       /* sha256 of all numbers of the model, hexadecimal */
  const char *judged_names; /* separated by commas */
} lts_soil_description;

typedef struct {
  lts_pose pose;     /* of the tool, its quaternion of length 1 */
  double force[3];   /* of the soil on the tool, world, N */
  double torque[3];  /* about the position of the pose, N m */
  double spread[6];  /* standard deviation over members of force and torque: along and square to the ground, across */
  double bound;      /* N, kept by the error of the force in 95 % of the frames of 9 of 10 runs that are like those
                      * of training; not a number where it is not known, as for fewer members than all */
  double payload;    /* m3 of soil in a bucket; its weight is part of force and torque */
  int32_t frame;     /* steps since the start */
  int32_t status;    /* of the worst judgement; LTS_OUTSIDE_... or LTS_NON_FINITE */
  int32_t passage;   /* how many have begun since the start: in the air a tool may turn to a new one */
  int32_t unused;
  lts_judgement now, worst; /* of this frame, and the worst since the start; `axis` is the number of the measure */
} lts_soil_result;

LTS_API int lts_soil_describe(const lts_soil_model *model, lts_soil_description *out);

/* Bytes that an instance needs, at any address; 0 where model, tool or terrain are none. */
LTS_API size_t lts_soil_size(const lts_soil_model *model, const lts_soil_tool *tool,
                             const lts_terrain *terrain);
/* Makes an instance of a tool on a terrain. LTS_ERROR_VALUE: a tool or terrain with values that cannot be, or a
 * kernel that this machine lacks. */
LTS_API int lts_soil_init(const lts_soil_model *model, const lts_soil_tool *tool,
                          lts_terrain *terrain, void *memory, size_t size, int kernel,
                          lts_soil **out);
/* Leaves the terrain, with the heights written that the tool has left. To be called before its memory goes. */
LTS_API int lts_soil_close(lts_soil *soil);
LTS_API int lts_soil_kernel(const lts_soil *soil);
/* How many of the networks answer, 1 .. M; all of them at first. */
LTS_API int lts_soil_members(lts_soil *soil, int members);

/* Sets the tool down from above. result may be null, here and below. LTS_ERROR_VALUE: a pose that is not
 * finite, is no rotation, or of a tool on its side; LTS_ERROR_PLACE: under the floor of the terrain. */
LTS_API int lts_soil_start(lts_soil *soil, const lts_pose *pose, lts_soil_result *result);
/* Moves the tool in a straight line to a pose within dt s. LTS_ERROR_JUMP: one that no tool reaches;
 * LTS_ERROR_VALUE: also a time that does not pass, or a terrain whose heights are not finite. */
LTS_API int lts_soil_step(lts_soil *soil, const lts_pose *pose, double dt, lts_soil_result *result);
/* The frame to which `lts_soil_step` would lead; nothing changes. */
LTS_API int lts_soil_propose(lts_soil *soil, const lts_pose *pose, double dt,
                             lts_soil_result *result);
/* The newest result. */
LTS_API int lts_soil_newest(const lts_soil *soil, lts_soil_result *result);
/* A judgement of a result in words, as lts_reason. */
LTS_API int lts_soil_reason(const lts_soil *soil, const lts_judgement *judgement, char *text,
                            size_t size);

/* How force and torque [6] answer to where the tool goes next: their derivative along a direction [6], a shift (m)
 * and a turn about the axes of the world (rad), of the pose that it reaches within dt s; null: where it is now. From
 * the frames at `reach` m (of a turn tenths of a rad per m) on either side; nothing changes. */
LTS_API int lts_soil_tangent(lts_soil *soil, const lts_pose *pose, double dt, const double *direction, double reach,
                             double *out);

/* Whether a step to a pose reads heights, 0 or 1: bins move on, or a new passage begins. Of an anchor it is a good
 * moment to begin a new one. */
LTS_API int lts_soil_reads(const lts_soil *soil, const lts_pose *pose);

/* Origin (y is 0), along and across [3][3] of the plane in which the tool goes. */
LTS_API int lts_soil_place(const lts_soil *soil, double *out);

/* Centre x, z and radius (m) [3] of what the tool has in sight, where it changes the terrain. */
LTS_API int lts_soil_footprint(const lts_soil *soil, double *out);

/* Writes what tools have done into the heights; heights are as all tools have left them then. */
LTS_API int lts_terrain_update(lts_terrain *terrain);
/* Height (m) at a place, between the middles of cells; beyond the map that of its edge. */
LTS_API double lts_terrain_at(const lts_terrain *terrain, double x, double z);

/* Particles. An anchor is a passage that leaves the terrain alone: `displacement` tells how far particles have moved
 * since. set_down: whether the tool comes from above; else it stands in soil that it has not moved. */
LTS_API int lts_soil_anchor(lts_soil *soil, const lts_pose *pose, int set_down);
/* Follows the tool to a pose that it reaches within dt s. */
LTS_API int lts_soil_follow(lts_soil *soil, const lts_pose *pose, double dt);
/* Where particles are now whose places at the start or anchor were points [n][3], m; into out [n][3], which may be
 * the same. Those that rest are the same to the last bit. */
LTS_API int lts_soil_displacement(lts_soil *soil, const double *points, size_t n, double *out);

/* What the networks see: float bins [J][n_bin][n_channel] and scalars [J][n_scalar] of J strips; either may be null.
 * Returns J. */
LTS_API int lts_soil_see(lts_soil *soil, float *bins, float *scalars);
/* Loads [M][6] of the members that answer: along and square to the ground, across; N, N m of the field. */
LTS_API int lts_soil_loads(lts_soil *soil, float *out);
/* How far the surface has risen at n places [n][2] u from the origin of the bins and across, m of the field. */
LTS_API int lts_soil_rise(lts_soil *soil, const double *places, size_t n, float *out);

/* Gives `to` the state of `from`: one of the same model and tool, on a terrain of the same cells that has the
 * content of the other. */
LTS_API int lts_soil_clone(lts_soil *to, const lts_soil *from);

/* Saves and restores an instance of the same model and tool, on a terrain of the same cells; heights are the
 * caller's to save and to restore. The size grows where the ground becomes uneven. LTS_ERROR_STATE: other bytes. */
LTS_API size_t lts_soil_state_size(const lts_soil *soil);
LTS_API int lts_soil_save(const lts_soil *soil, void *bytes, size_t size);
LTS_API int lts_soil_restore(lts_soil *soil, const void *bytes, size_t size);

#ifdef __cplusplus
}
#endif

#endif
