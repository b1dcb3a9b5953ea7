/* What an FMU is apart from the standard: variables, life, steps and states around the C interface of a
 * model. fmi2.c puts the functions of the standard around it. Functions return null, or what is wrong. */
#ifndef FMU_CORE_H
#define FMU_CORE_H

#include "fmu_model.h" /* generated: the model, its GUID and sizes */

#define FMU_STATUS_BITS 6

/* Value references of the reals; modelDescription.xml is written from the same order. */
enum {
  VR_POSITION = 0,
  VR_ROTATION = 3,
  VR_LINEAR = 7,
  VR_ANGULAR = 10,
  VR_POINT = 13, /* the first output */
  VR_FORCE = 16,
  VR_MOMENT = 19,
  VR_SINKAGE = 22,
  VR_DRAWBAR = 23,
  VR_FRAME_TIME = 24,
  VR_CONTEXT = 25, /* fixed parameters */
  N_REAL = VR_CONTEXT + FMU_CONTEXT
};
enum { N_BOOLEAN = 4 }; /* ok, extrapolating, left_bounds, non_finite */

typedef enum { FMU_CREATED, FMU_INITIALISING, FMU_STEPPING, FMU_TERMINATED } fmu_phase;

/* What a saved FMU state holds, before the state of the model. */
typedef struct {
  fmu_phase now;
  int begun;       /* whether the model has been started from the current values */
  int start, told; /* told: status bits that have held since the start */
  double time, first_height;
  double real[N_REAL];
} fmu_values;

typedef struct fmu_core fmu_core;
struct fmu_core {
  void (*warn)(fmu_core *core, const char *text); /* of the standard's layer */
  fmu_values v;
  lts_instance *soil;
};

const char *fmu_make(fmu_core *core, void *memory, size_t size); /* in memory for the model */
lts_description fmu_described(void);
void fmu_defaults(fmu_core *core);
const char *fmu_initialise(fmu_core *core, double time);
const char *fmu_start_stepping(fmu_core *core);
const char *fmu_step(fmu_core *core, double time, double h);
const char *fmu_get_reals(fmu_core *core, const unsigned *vr, size_t n, double *value);
const char *fmu_set_reals(fmu_core *core, const unsigned *vr, size_t n, const double *value);
const char *fmu_set_start(fmu_core *core, int start);
/* Status by number of a Boolean variable; `told` is up to date afterwards. */
const char *fmu_status(fmu_core *core, unsigned which, int *value);
/* A state: its values, then the bytes of the model. */
size_t fmu_state_size(const fmu_core *core);
const char *fmu_write_state(fmu_core *core, void *bytes);
const char *fmu_read_state(fmu_core *core, const void *bytes, size_t size);

#endif
