/* What fmi2.c, the functions of the standard, asks of fmu_soil.c: a soil field with FMU_TOOLS tools on a terrain that
 * begins level. Functions return null, or what is wrong. */
#ifndef FMU_CORE_H
#define FMU_CORE_H

#include <stddef.h>
#include <string.h>

#include "fmu_model.h" /* generated: the model, its GUID, its tools and variables */

typedef enum { FMU_CREATED, FMU_INITIALISING, FMU_STEPPING, FMU_TERMINATED } fmu_phase;

/* Places at which heights are told, along and across, the tool in the middle. */
enum { FMU_ALONG = 9, FMU_ACROSS = 5 };

/* Value references of the reals of a tool, of which the first begins at 0, the second at VR_TOOL, and so on; then those
 * of the ground. modelDescription.xml is written from the same order. */
enum {
  VR_POSITION = 0,
  VR_ROTATION = 3,
  VR_LINEAR = 7,
  VR_ANGULAR = 10,
  VR_POINT = 13, /* the first output */
  VR_FORCE = 16,
  VR_MOMENT = 19,
  VR_SPREAD = 22,
  VR_BOUND = VR_SPREAD + 6,
  VR_SINKAGE,
  VR_DRAWBAR,
  VR_HEIGHTS,
  VR_SHAPE = VR_HEIGHTS + FMU_ALONG * FMU_ACROSS, /* the first parameter: lts_soil_tool */
  VR_TOOL = VR_SHAPE + 7
};
enum {
  VR_GROUND = VR_TOOL * FMU_TOOLS,
  VR_SIZE = VR_GROUND, /* along x and z */
  VR_CELL = VR_GROUND + 2,
  VR_HEIGHT,
  VR_DEPTH,
  VR_FRICTION,
  VR_DENSITY,
  VR_GRAVITY,
  VR_GRID,
  N_REAL
};
/* What a real variable is, by its value reference: FMU_KINDS of fmu_model.h. */
enum { FMU_NONE, FMU_INPUT, FMU_OUTPUT, FMU_PARAMETER, FMU_CONSTANT };

enum { N_BOOLEAN = 4 }; /* of a tool: ok, ok_now, extrapolating, non_finite */

typedef struct {
  double h;            /* of the last step, s */
  int told[FMU_TOOLS]; /* status bits that have held since the start */
} fmu_own;

typedef struct {
  lts_terrain ground;
  void *memory[FMU_TOOLS];
  lts_soil *soil[FMU_TOOLS];
  int shown[FMU_TOOLS]; /* whether heights are those of now */
  double *built; /* reals that it was built for */
  char text[FMU_TOOLS][200], wrong[200];
} fmu_model;

/* What a saved state begins with. */
typedef struct {
  fmu_phase now;
  int begun; /* whether the model has been started from the current values */
  double time;
  fmu_own own;
  double real[N_REAL];
} fmu_values;

typedef struct fmu_core fmu_core;
struct fmu_core {
  void (*warn)(fmu_core *core, const char *text); /* of the standard's layer */
  void *(*allocate)(size_t n, size_t size);
  void (*release)(void *memory);
  fmu_values v;
  fmu_model model;
};

/* ---- the model ---- */
const char *fmu_make(fmu_core *core); /* takes memory, which fmu_free gives back */
void fmu_free(fmu_core *core);
/* After the values have got those of fmu_model.h. */
void fmu_clear(fmu_core *core);
/* Starts the model from the current values, once they have changed. */
const char *fmu_begin(fmu_core *core);
const char *fmu_go(fmu_core *core, double h);
/* Computes an output that is not computed before somebody looks. */
void fmu_show(fmu_core *core, unsigned vr);
const char *fmu_get_integer(fmu_core *core, unsigned vr, int *value);
const char *fmu_get_boolean(fmu_core *core, unsigned vr, int *value);
const char *fmu_get_string(fmu_core *core, unsigned vr, const char **value);
const char *fmu_derivative(fmu_core *core, const unsigned *unknown, size_t n_unknown, const unsigned *known,
                           size_t n_known, const double *d_known, double *d_unknown);
/* A state: its values, then the bytes of the model. */
size_t fmu_state_size(const fmu_core *core);
const char *fmu_write_state(fmu_core *core, void *bytes);
const char *fmu_read_state(fmu_core *core, const void *bytes, size_t size);

/* ---- what models share ---- */
#define FMU_TOO_LATE "a fixed parameter is set after the initialisation"

/* Starts the model for whoever looks at an output before the first step. */
static inline const char *fmu_begin_early(fmu_core *core) {
  return core->v.now == FMU_INITIALISING ? fmu_begin(core) : NULL;
}

/* Pose of a body whose inputs are reals from `inputs` on, at the beginning of a communication step, and its
 * velocity. A model wants the coming pose: the velocity leads to it. */
static inline lts_pose fmu_pose(const double *inputs) {
  lts_pose pose;
  memcpy(pose.position, inputs + VR_POSITION, sizeof pose.position);
  memcpy(pose.rotation, inputs + VR_ROTATION, sizeof pose.rotation);
  return pose;
}

static inline lts_twist fmu_twist(const double *inputs) {
  lts_twist twist;
  memcpy(twist.linear, inputs + VR_LINEAR, sizeof twist.linear);
  memcpy(twist.angular, inputs + VR_ANGULAR, sizeof twist.angular);
  return twist;
}

#endif
