/* What an FMU is apart from the standard: variables, life, steps and states around the C interface of a model.
 * fmi2.c puts the functions of the standard around it; fmu_graph.c or fmu_soil.c is the model. Functions return
 * null, or what is wrong. */
#ifndef FMU_CORE_H
#define FMU_CORE_H

#include <stddef.h>

#include "fmu_model.h" /* generated: the model, its GUID, its numbers of variables, and FMU_LAYOUT */

typedef enum { FMU_CREATED, FMU_INITIALISING, FMU_STEPPING, FMU_TERMINATED } fmu_phase;

#include FMU_LAYOUT /* of a kind of model: `fmu_values`, which a saved state begins with, and `fmu_model` */

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
void fmu_defaults(fmu_core *core);
/* Starts the model from the current values, once they have changed. */
const char *fmu_begin(fmu_core *core);
const char *fmu_go(fmu_core *core, double h);
const char *fmu_get_reals(fmu_core *core, const unsigned *vr, size_t n, double *value);
const char *fmu_set_reals(fmu_core *core, const unsigned *vr, size_t n, const double *value);
const char *fmu_get_integer(fmu_core *core, unsigned vr, int *value);
const char *fmu_set_integer(fmu_core *core, unsigned vr, int value);
const char *fmu_get_boolean(fmu_core *core, unsigned vr, int *value);
const char *fmu_get_string(fmu_core *core, unsigned vr, const char **value);
const char *fmu_derivative(fmu_core *core, const unsigned *unknown, size_t n_unknown, const unsigned *known,
                           size_t n_known, const double *d_known, double *d_unknown);
/* A state: its values, then the bytes of the model. */
size_t fmu_state_size(const fmu_core *core);
const char *fmu_write_state(fmu_core *core, void *bytes);
const char *fmu_read_state(fmu_core *core, const void *bytes, size_t size);

/* ---- fmu_core.c ---- */
const char *fmu_initialise(fmu_core *core);
const char *fmu_start_stepping(fmu_core *core);
const char *fmu_step(fmu_core *core, double time, double h);
/* Whether a parameter may still be set, and a value is a number. */
const char *fmu_check_set(const fmu_core *core, int is_parameter, double value);

#endif
