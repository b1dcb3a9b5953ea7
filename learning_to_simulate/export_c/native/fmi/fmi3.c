/* FMI 3.0 co-simulation: as fmi2.c, and the particles and the height map as arrays. Written against the
 * standard's text; the types and functions are declared here, so that no header has to be fetched. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmu_core.h"

#if defined(_WIN32)
#define FMI3_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define FMI3_EXPORT __attribute__((visibility("default")))
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard asks for all of them */
#else
#define FMI3_EXPORT
#endif
/* Importers that link sources of several FMUs together define a prefix. */
#if defined(FMI3_FUNCTION_PREFIX)
#define FMI3_PASTE(a, b) a##b
#define FMI3_PASTED(a, b) FMI3_PASTE(a, b)
#define FMI3(name) FMI3_PASTED(FMI3_FUNCTION_PREFIX, name)
#else
#define FMI3(name) name
#endif

typedef void *fmi3Instance;
typedef void *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef void (*fmi3LogMessageCallback)(void *environment, fmi3Status status, const char *category,
                                       const char *message);
typedef void (*fmi3IntermediateUpdateCallback)(void);

/* Value references: those of the reals, then these; modelDescription.xml is written in this order. */
enum { VR_START = N_REAL, VR_STATUS, VR_DIGEST = VR_STATUS + N_BOOLEAN, VR_HEIGHTS, VR_PARTICLES, VR_TIME };

typedef struct {
  fmu_core core; /* the first field: a core is its component */
  void *environment;
  fmi3LogMessageCallback log;
  int logs;
} component;

static void log_text(component *c, fmi3Status status, const char *category, const char *text) {
  if (c->log && (c->logs || status >= fmi3Error)) c->log(c->environment, status, category, text);
}

static void warn(fmu_core *core, const char *text) {
  log_text((component *)core, fmi3Warning, "logStatusWarning", text);
}

static fmi3Status refuse(component *c, const char *text) {
  log_text(c, fmi3Error, "logStatusError", text);
  return fmi3Error;
}

static fmi3Status done(component *c, const char *wrong) { return wrong ? refuse(c, wrong) : fmi3OK; }

/* ---- life ---- */

FMI3_EXPORT const char *FMI3(fmi3GetVersion)(void) { return "3.0"; }

FMI3_EXPORT fmi3Instance FMI3(fmi3InstantiateCoSimulation)(
    const char *name, const char *token, const char *resources, bool visible, bool logs,
    bool event_mode, bool early_return, const fmi3ValueReference intermediate[],
    size_t n_intermediate, void *environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update) {
  component probe;
  memset(&probe, 0, sizeof probe);
  probe.environment = environment;
  probe.log = log;
  if (!name || !token) return NULL;
  if (strcmp(token, FMU_GUID) || event_mode || n_intermediate) {
    refuse(&probe, event_mode || n_intermediate ? "no event mode and no intermediate variables"
                                                : "the token is not that of this FMU");
    return NULL;
  }
  const size_t size = fmu_soil_size();
  char *block = (char *)calloc(1, sizeof(component) + size);
  if (!block) {
    refuse(&probe, "out of memory");
    return NULL;
  }
  component *c = (component *)(void *)block;
  *c = probe;
  c->logs = logs;
  c->core.warn = warn;
  const char *wrong = fmu_soil_make(block + sizeof *c, size, &c->core.soil);
  if (wrong) {
    refuse(c, wrong);
    free(block);
    return NULL;
  }
  fmu_defaults(&c->core);
  return c;
}

FMI3_EXPORT void FMI3(fmi3FreeInstance)(fmi3Instance instance) { free(instance); }

FMI3_EXPORT fmi3Status FMI3(fmi3SetDebugLogging)(fmi3Instance instance, bool on, size_t n,
                                                 const char *const categories[]) {
  if (!instance) return fmi3Error;
  ((component *)instance)->logs = on;
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3EnterInitializationMode)(fmi3Instance instance, bool has_tolerance,
                                                         double tolerance, double start,
                                                         bool has_stop, double stop) {
  component *c = (component *)instance;
  return c ? done(c, fmu_initialise(&c->core, start)) : fmi3Error;
}

FMI3_EXPORT fmi3Status FMI3(fmi3ExitInitializationMode)(fmi3Instance instance) {
  component *c = (component *)instance;
  return c ? done(c, fmu_start_stepping(&c->core)) : fmi3Error;
}

FMI3_EXPORT fmi3Status FMI3(fmi3Terminate)(fmi3Instance instance) {
  if (!instance) return fmi3Error;
  ((component *)instance)->core.v.now = FMU_TERMINATED;
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3Reset)(fmi3Instance instance) {
  if (!instance) return fmi3Error;
  fmu_defaults(&((component *)instance)->core);
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3DoStep)(fmi3Instance instance, double time, double h,
                                        bool no_set_state, bool *event_needed, bool *terminate,
                                        bool *early_return, double *last_time) {
  component *c = (component *)instance;
  if (!c || !event_needed || !terminate || !early_return || !last_time) return fmi3Error;
  *event_needed = *terminate = *early_return = false;
  const char *wrong = fmu_step(&c->core, time, h);
  *last_time = c->core.v.time;
  return done(c, wrong);
}

/* ---- variables ---- */

FMI3_EXPORT fmi3Status FMI3(fmi3GetFloat64)(fmi3Instance instance, const fmi3ValueReference vr[],
                                            size_t n, double values[], size_t n_values) {
  component *c = (component *)instance;
  if (!c || n != n_values || (n && (!vr || !values))) return fmi3Error;
  for (size_t i = 0; i < n; ++i) {
    if (vr[i] == VR_TIME) {
      values[i] = c->core.v.time;
      continue;
    }
    const unsigned one = vr[i];
    const char *wrong = fmu_get_reals(&c->core, &one, 1, values + i);
    if (wrong) return refuse(c, wrong);
  }
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3SetFloat64)(fmi3Instance instance, const fmi3ValueReference vr[],
                                            size_t n, const double values[], size_t n_values) {
  component *c = (component *)instance;
  if (!c || n != n_values || (n && (!vr || !values))) return fmi3Error;
  return done(c, fmu_set_reals(&c->core, vr, n, values));
}

FMI3_EXPORT fmi3Status FMI3(fmi3GetFloat32)(fmi3Instance instance, const fmi3ValueReference vr[],
                                            size_t n, float values[], size_t n_values) {
  component *c = (component *)instance;
  size_t at = 0;
  if (!c || (n && (!vr || !values))) return fmi3Error;
  for (size_t i = 0; i < n; ++i) {
    const size_t size = vr[i] == VR_HEIGHTS ? FMU_CELLS : vr[i] == VR_PARTICLES ? 3 * FMU_SOIL : 0;
    if (!size) return refuse(c, "no Float32 variable of this value reference");
    if (n_values - at < size || at > n_values) return refuse(c, "an array has another size");
    const char *wrong = vr[i] == VR_HEIGHTS ? fmu_heights(&c->core, values + at)
                                            : fmu_particles(&c->core, values + at);
    if (wrong) return refuse(c, wrong);
    at += size;
  }
  return at == n_values ? fmi3OK : refuse(c, "an array has another size");
}

FMI3_EXPORT fmi3Status FMI3(fmi3GetInt32)(fmi3Instance instance, const fmi3ValueReference vr[],
                                          size_t n, int32_t values[], size_t n_values) {
  component *c = (component *)instance;
  if (!c || n != n_values || (n && (!vr || !values))) return fmi3Error;
  for (size_t i = 0; i < n; ++i) {
    if (vr[i] != VR_START) return refuse(c, "no Int32 variable of this value reference");
    values[i] = c->core.v.start;
  }
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3SetInt32)(fmi3Instance instance, const fmi3ValueReference vr[],
                                          size_t n, const int32_t values[], size_t n_values) {
  component *c = (component *)instance;
  if (!c || n != n_values || (n && (!vr || !values))) return fmi3Error;
  for (size_t i = 0; i < n; ++i) {
    const char *wrong = vr[i] == VR_START ? fmu_set_start(&c->core, values[i])
                                          : "no Int32 variable of this value reference";
    if (wrong) return refuse(c, wrong);
  }
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3GetBoolean)(fmi3Instance instance, const fmi3ValueReference vr[],
                                            size_t n, bool values[], size_t n_values) {
  component *c = (component *)instance;
  if (!c || n != n_values || (n && (!vr || !values))) return fmi3Error;
  for (size_t i = 0; i < n; ++i) {
    int value = 0;
    const char *wrong = fmu_status(&c->core, vr[i] - VR_STATUS, &value);
    if (wrong) return refuse(c, wrong);
    values[i] = value;
  }
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3GetString)(fmi3Instance instance, const fmi3ValueReference vr[],
                                           size_t n, const char *values[], size_t n_values) {
  component *c = (component *)instance;
  if (!c || n != n_values || (n && (!vr || !values))) return fmi3Error;
  for (size_t i = 0; i < n; ++i) {
    if (vr[i] != VR_DIGEST) return refuse(c, "no String variable of this value reference");
    values[i] = fmu_soil_digest();
  }
  return fmi3OK;
}

/* ---- state: its size, then the bytes of the core ---- */

static fmi3Status room_for(component *c, size_t size, fmi3FMUState *state) {
  void *room = realloc(*state, sizeof size + size);
  if (!room) return refuse(c, "out of memory");
  memcpy(room, &size, sizeof size);
  *state = room;
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3GetFMUState)(fmi3Instance instance, fmi3FMUState *state) {
  component *c = (component *)instance;
  if (!c || !state) return fmi3Error;
  if (room_for(c, fmu_state_size(&c->core), state) != fmi3OK) return fmi3Error;
  return done(c, fmu_write_state(&c->core, (char *)*state + sizeof(size_t)));
}

FMI3_EXPORT fmi3Status FMI3(fmi3SetFMUState)(fmi3Instance instance, fmi3FMUState state) {
  component *c = (component *)instance;
  size_t size;
  if (!c || !state) return fmi3Error;
  memcpy(&size, state, sizeof size);
  return done(c, fmu_read_state(&c->core, (const char *)state + sizeof size, size));
}

FMI3_EXPORT fmi3Status FMI3(fmi3FreeFMUState)(fmi3Instance instance, fmi3FMUState *state) {
  if (!instance || !state) return fmi3Error;
  free(*state);
  *state = NULL;
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3SerializedFMUStateSize)(fmi3Instance instance, fmi3FMUState state,
                                                        size_t *size) {
  if (!instance || !state || !size) return fmi3Error;
  memcpy(size, state, sizeof *size);
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3SerializeFMUState)(fmi3Instance instance, fmi3FMUState state,
                                                   uint8_t bytes[], size_t size) {
  size_t needed;
  if (!instance || !state || !bytes) return fmi3Error;
  memcpy(&needed, state, sizeof needed);
  if (size < needed) return fmi3Error;
  memcpy(bytes, (const char *)state + sizeof needed, needed);
  return fmi3OK;
}

FMI3_EXPORT fmi3Status FMI3(fmi3DeserializeFMUState)(fmi3Instance instance, const uint8_t bytes[],
                                                     size_t size, fmi3FMUState *state) {
  component *c = (component *)instance;
  if (!c || !bytes || !state) return fmi3Error;
  if (room_for(c, size, state) != fmi3OK) return fmi3Error;
  memcpy((char *)*state + sizeof size, bytes, size);
  return fmi3OK;
}

#include "fmi3_rest.h"
