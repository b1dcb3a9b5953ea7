/* FMI 2.0 co-simulation. Written against the standard's text; the types and functions are declared here,
 * so that no header has to be fetched. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "fmu_core.h"

#if defined(_WIN32)
#define FMI2_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define FMI2_EXPORT __attribute__((visibility("default")))
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard asks for all of them */
#else
#define FMI2_EXPORT
#endif
/* Importers that link sources of several FMUs together define a prefix. */
#if defined(FMI2_FUNCTION_PREFIX)
#define FMI2_PASTE(a, b) a##b
#define FMI2_PASTED(a, b) FMI2_PASTE(a, b)
#define FMI2(name) FMI2_PASTED(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI2(name) name
#endif

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
  fmi2DoStepStatus,
  fmi2PendingStatus,
  fmi2LastSuccessfulTime,
  fmi2Terminated
} fmi2StatusKind;
typedef struct {
  void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
  void *(*allocateMemory)(size_t, size_t);
  void (*freeMemory)(void *);
  void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
  fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

typedef struct {
  fmu_core core; /* the first field: a core is its component */
  fmi2CallbackFunctions call;
  fmi2String name;
  int logs;
} component;

static void log_text(component *c, fmi2Status status, fmi2String category, fmi2String text) {
  if (c->call.logger && (c->logs || status >= fmi2Error)) {
    /* No text has a % in it: importers differ in whether they expand formats. */
    c->call.logger(c->call.componentEnvironment, c->name, status, category, text);
  }
}

static void warn(fmu_core *core, const char *text) {
  log_text((component *)core, fmi2Warning, "logStatusWarning", text);
}

static fmi2Status refuse(component *c, fmi2String text) {
  log_text(c, fmi2Error, "logStatusError", text);
  return fmi2Error;
}

/* What a function of the model says. */
static fmi2Status done(component *c, const char *wrong) { return wrong ? refuse(c, wrong) : fmi2OK; }

/* ---- life ---- */

static const double first_values[N_REAL] = FMU_FIRST;
static const unsigned char kinds[N_REAL] = FMU_KINDS;

static void make_default(fmu_core *core) {
  memset(&core->v, 0, sizeof core->v);
  memcpy(core->v.real, first_values, sizeof first_values);
  fmu_clear(core);
}

FMI2_EXPORT const char *FMI2(fmi2GetTypesPlatform)(void) { return "default"; }
FMI2_EXPORT const char *FMI2(fmi2GetVersion)(void) { return "2.0"; }

FMI2_EXPORT fmi2Component FMI2(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid,
                                                fmi2String resources,
                                                const fmi2CallbackFunctions *call,
                                                fmi2Boolean visible, fmi2Boolean logs) {
  if (!call || !call->allocateMemory || !call->freeMemory || !name || !guid) return NULL;
  component probe;
  memset(&probe, 0, sizeof probe);
  probe.call = *call;
  probe.name = name;
  if (type != fmi2CoSimulation || strcmp(guid, FMU_GUID)) {
    refuse(&probe, type != fmi2CoSimulation ? "this FMU is for co-simulation only"
                                            : "the GUID is not that of this FMU");
    return NULL;
  }
  /* One block: the component and its name. */
  const size_t length = strlen(name) + 1;
  char *block = (char *)call->allocateMemory(1, sizeof(component) + length);
  if (!block) {
    refuse(&probe, "out of memory");
    return NULL;
  }
  component *c = (component *)(void *)block;
  *c = probe;
  c->name = (fmi2String)memcpy(block + sizeof *c, name, length);
  c->logs = logs;
  c->core.warn = warn;
  c->core.allocate = call->allocateMemory;
  c->core.release = call->freeMemory;
  const char *wrong = fmu_make(&c->core);
  if (wrong) {
    refuse(c, wrong);
    fmu_free(&c->core);
    call->freeMemory(block);
    return NULL;
  }
  make_default(&c->core);
  return c;
}

/* The component of a call; without one nothing can even be logged. */
#define OPEN(c)                                 \
  component *c = (component *)instance;         \
  if (!c) return fmi2Error
/* Likewise, of a call with n variables. */
#define OPEN_VALUES(c)                                           \
  component *c = (component *)instance;                          \
  if (!c || (n && (!vr || !value))) return fmi2Error

FMI2_EXPORT void FMI2(fmi2FreeInstance)(fmi2Component instance) {
  component *c = (component *)instance;
  if (!c) return;
  fmu_free(&c->core);
  c->call.freeMemory(c);
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetDebugLogging)(fmi2Component instance, fmi2Boolean on, size_t n,
                                                 const fmi2String categories[]) {
  OPEN(c);
  c->logs = on;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetupExperiment)(fmi2Component instance, fmi2Boolean has_tolerance,
                                                 fmi2Real tolerance, fmi2Real start,
                                                 fmi2Boolean has_stop, fmi2Real stop) {
  OPEN(c);
  if (c->core.v.now != FMU_CREATED) {
    return refuse(c, "fmi2SetupExperiment after the initialisation");
  }
  c->core.v.time = start;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2EnterInitializationMode)(fmi2Component instance) {
  OPEN(c);
  if (c->core.v.now != FMU_CREATED) return refuse(c, "the initialisation is entered twice");
  c->core.v.now = FMU_INITIALISING;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2ExitInitializationMode)(fmi2Component instance) {
  OPEN(c);
  if (c->core.v.now != FMU_INITIALISING) return refuse(c, "the initialisation is left out of turn");
  const char *wrong = fmu_begin(&c->core);
  if (!wrong) c->core.v.now = FMU_STEPPING;
  return done(c, wrong);
}

FMI2_EXPORT fmi2Status FMI2(fmi2Terminate)(fmi2Component instance) {
  OPEN(c);
  c->core.v.now = FMU_TERMINATED;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2Reset)(fmi2Component instance) {
  OPEN(c);
  make_default(&c->core);
  return fmi2OK;
}

/* ---- variables ---- */

static const char *get_real(fmu_core *core, fmi2ValueReference vr, double *value) {
  if (vr >= N_REAL) return "no real variable of this value reference";
  if (kinds[vr] == FMU_OUTPUT) {
    const char *wrong = fmu_begin_early(core);
    if (wrong) return wrong;
    if (core->v.begun) fmu_show(core, vr);
  }
  *value = core->v.real[vr];
  return NULL;
}

/* Whether a real can be set, and to a value. */
static const char *check_real(const fmu_core *core, fmi2ValueReference vr, double value) {
  const int kind = vr < N_REAL ? kinds[vr] : FMU_NONE;
  if (kind != FMU_INPUT && kind != FMU_PARAMETER) return "this real variable cannot be set";
  if (kind == FMU_PARAMETER && core->v.now >= FMU_STEPPING) return FMU_TOO_LATE;
  return isfinite(value) ? NULL : "an input or parameter is not finite";
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetReal)(fmi2Component instance, const fmi2ValueReference vr[],
                                         size_t n, const fmi2Real value[]) {
  OPEN_VALUES(c);
  const char *wrong = NULL;
  for (size_t i = 0; i < n && !wrong; ++i) wrong = check_real(&c->core, vr[i], value[i]);
  if (wrong) return refuse(c, wrong); /* none is set */
  for (size_t i = 0; i < n; ++i) c->core.v.real[vr[i]] = value[i];
  if (c->core.v.now < FMU_STEPPING) c->core.v.begun = 0;
  return fmi2OK;
}

/* Functions of several variables, by one for each. */
#define EACH(name, type, call)                                                                        \
  FMI2_EXPORT fmi2Status FMI2(name)(fmi2Component instance, const fmi2ValueReference vr[], size_t n,  \
                                    type value[]) {                                                   \
    OPEN_VALUES(c);                                                                                   \
    const char *wrong = NULL;                                                                         \
    for (size_t i = 0; i < n && !wrong; ++i) wrong = call;                                            \
    return done(c, wrong);                                                                            \
  }
EACH(fmi2GetReal, fmi2Real, get_real(&c->core, vr[i], &value[i]))
EACH(fmi2GetInteger, fmi2Integer, fmu_get_integer(&c->core, vr[i], &value[i]))
EACH(fmi2SetInteger, const fmi2Integer, "no integer variable can be set")
EACH(fmi2GetBoolean, fmi2Boolean, fmu_get_boolean(&c->core, vr[i], &value[i]))
EACH(fmi2SetBoolean, const fmi2Boolean, "no boolean variable can be set")
EACH(fmi2GetString, fmi2String, fmu_get_string(&c->core, vr[i], &value[i]))
EACH(fmi2SetString, const fmi2String, "no string variable can be set")

/* ---- steps ---- */

FMI2_EXPORT fmi2Status FMI2(fmi2DoStep)(fmi2Component instance, fmi2Real time, fmi2Real h,
                                        fmi2Boolean no_set_state) {
  OPEN(c);
  if (c->core.v.now != FMU_STEPPING) return refuse(c, "a step before the end of the initialisation");
  if (!(h > 0.0) || !isfinite(time)) return refuse(c, "the step has no positive length");
  const char *wrong = fmu_go(&c->core, h);
  if (!wrong) c->core.v.time = time + h;
  return done(c, wrong);
}

FMI2_EXPORT fmi2Status FMI2(fmi2CancelStep)(fmi2Component instance) {
  OPEN(c);
  return refuse(c, "steps are never pending");
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetRealInputDerivatives)(fmi2Component instance,
                                                         const fmi2ValueReference vr[], size_t n,
                                                         const fmi2Integer order[],
                                                         const fmi2Real value[]) {
  OPEN(c);
  return done(c, n ? "the velocities are inputs; derivatives are not taken" : NULL);
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetRealOutputDerivatives)(fmi2Component instance,
                                                          const fmi2ValueReference vr[], size_t n,
                                                          const fmi2Integer order[],
                                                          fmi2Real value[]) {
  OPEN(c);
  return done(c, n ? "outputs have no derivatives" : NULL);
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetDirectionalDerivative)(
    fmi2Component instance, const fmi2ValueReference unknown[], size_t n_unknown,
    const fmi2ValueReference known[], size_t n_known, const fmi2Real d_known[],
    fmi2Real d_unknown[]) {
  OPEN(c);
  if (n_unknown && (!unknown || !d_unknown || (n_known && (!known || !d_known)))) return fmi2Error;
  return done(c, fmu_derivative(&c->core, unknown, n_unknown, known, n_known, d_known, d_unknown));
}

/* Steps are never pending: a status is asked for in vain, but for the time and the end. */
#define GET_STATUS(name, type, known, found)                                               \
  FMI2_EXPORT fmi2Status FMI2(name)(fmi2Component instance, const fmi2StatusKind kind,     \
                                    type * value) {                                        \
    OPEN(c);                                                                               \
    if (!value) return fmi2Error;                                                          \
    if (!(known)) return fmi2Discard;                                                      \
    *value = found;                                                                        \
    return fmi2OK;                                                                         \
  }
GET_STATUS(fmi2GetStatus, fmi2Status, 1, fmi2OK)
GET_STATUS(fmi2GetRealStatus, fmi2Real, kind == fmi2LastSuccessfulTime, c->core.v.time)
GET_STATUS(fmi2GetIntegerStatus, fmi2Integer, 0, 0)
GET_STATUS(fmi2GetBooleanStatus, fmi2Boolean, kind == fmi2Terminated, 0)
GET_STATUS(fmi2GetStringStatus, fmi2String, 0, "")

/* ---- state: its size, then the bytes of the core ---- */

static fmi2Status room_for(component *c, size_t size, fmi2FMUstate *state) {
  size_t had = 0;
  if (*state) memcpy(&had, *state, sizeof had);
  if (*state && had != size) {
    c->call.freeMemory(*state);
    *state = NULL;
  }
  if (!*state) *state = c->call.allocateMemory(1, sizeof size + size);
  if (!*state) return refuse(c, "out of memory");
  memcpy(*state, &size, sizeof size);
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetFMUstate)(fmi2Component instance, fmi2FMUstate *state) {
  OPEN(c);
  if (!state) return fmi2Error;
  const fmi2Status status = room_for(c, fmu_state_size(&c->core), state);
  if (status != fmi2OK) return status;
  return done(c, fmu_write_state(&c->core, (char *)*state + sizeof(size_t)));
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetFMUstate)(fmi2Component instance, fmi2FMUstate state) {
  OPEN(c);
  size_t size;
  if (!state) return fmi2Error;
  memcpy(&size, state, sizeof size);
  return done(c, fmu_read_state(&c->core, (const char *)state + sizeof size, size));
}

FMI2_EXPORT fmi2Status FMI2(fmi2FreeFMUstate)(fmi2Component instance, fmi2FMUstate *state) {
  OPEN(c);
  if (!state) return fmi2Error;
  if (*state) c->call.freeMemory(*state);
  *state = NULL;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SerializedFMUstateSize)(fmi2Component instance, fmi2FMUstate state,
                                                        size_t *size) {
  if (!instance || !state || !size) return fmi2Error;
  memcpy(size, state, sizeof *size);
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SerializeFMUstate)(fmi2Component instance, fmi2FMUstate state,
                                                   fmi2Byte bytes[], size_t size) {
  size_t needed;
  if (!instance || !state || !bytes) return fmi2Error;
  memcpy(&needed, state, sizeof needed);
  if (size < needed) return fmi2Error;
  memcpy(bytes, (const char *)state + sizeof needed, needed);
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2DeSerializeFMUstate)(fmi2Component instance, const fmi2Byte bytes[],
                                                     size_t size, fmi2FMUstate *state) {
  OPEN(c);
  if (!bytes || !state) return fmi2Error;
  const fmi2Status status = room_for(c, size, state);
  if (status == fmi2OK) memcpy((char *)*state + sizeof size, bytes, size);
  return status;
}
