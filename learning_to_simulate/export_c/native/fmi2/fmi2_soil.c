/* FMI 2.0 co-simulation around the C interface of a model. Written against the standard's text; the
 * types and functions are declared here, so that no header has to be fetched.
 *
 * Inputs are the pose and the velocity of the body at the beginning of a communication step. The model
 * wants the coming pose: the velocity leads to it. Frames stay whole: see lts_advance.
 */
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include "fmu_model.h" /* generated: the model, its GUID and sizes */
#include "lts.h"

#if defined(_WIN32)
#define FMI2_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define FMI2_EXPORT __attribute__((visibility("default")))
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

/* Value references of the reals; modelDescription.xml is written from the same order. */
enum {
  VR_POSITION = 0,
  VR_ROTATION = 3,
  VR_LINEAR = 7,
  VR_ANGULAR = 10,
  VR_POINT = 13,
  VR_FORCE = 16,
  VR_MOMENT = 19,
  VR_SINKAGE = 22,
  VR_DRAWBAR = 23,
  VR_FRAME_TIME = 24,
  VR_CONTEXT = 25,
  N_REAL = VR_CONTEXT + FMU_CONTEXT
};
enum { N_BOOLEAN = 4 }; /* ok, extrapolating, left_bounds, non_finite */

typedef enum { CREATED, INITIALISING, STEPPING, TERMINATED } phase;

/* What a saved FMU state holds, before the state of the model. */
typedef struct {
  phase now;
  int begun; /* whether the model has been started from the current values */
  int start, told; /* told: status bits that have held since the start */
  double time, first_height;
  double real[N_REAL];
} values;

typedef struct {
  fmi2CallbackFunctions call;
  fmi2String name;
  int logs;
  values v;
  lts_instance *soil;
} component;

static void log_text(component *c, fmi2Status status, fmi2String category, fmi2String text) {
  if (c->call.logger && (c->logs || status >= fmi2Error)) {
    /* No text has a % in it: importers differ in whether they expand formats. */
    c->call.logger(c->call.componentEnvironment, c->name, status, category, text);
  }
}

static fmi2Status refuse(component *c, fmi2String text) {
  log_text(c, fmi2Error, "logStatusError", text);
  return fmi2Error;
}

static lts_pose pose_of(const values *v) {
  lts_pose pose;
  memcpy(pose.position, v->real + VR_POSITION, sizeof pose.position);
  memcpy(pose.rotation, v->real + VR_ROTATION, sizeof pose.rotation);
  return pose;
}

static lts_twist twist_of(const values *v) {
  lts_twist twist;
  memcpy(twist.linear, v->real + VR_LINEAR, sizeof twist.linear);
  memcpy(twist.angular, v->real + VR_ANGULAR, sizeof twist.angular);
  return twist;
}

/* Force along the travel, across the up axis; 0 at rest. */
static double drawbar_of(const double *linear, const double *force, int up) {
  double along = 0.0, square = 0.0;
  for (int i = 0; i < 3; ++i) {
    if (i == up) continue;
    along += linear[i] * force[i];
    square += linear[i] * linear[i];
  }
  return square > 0.0 ? along / sqrt(square) : 0.0;
}

static void take_result(component *c, const lts_result *result) {
  lts_description model;
  double *real = c->v.real;
  lts_describe(&FMU_MODEL, &model);
  memcpy(real + VR_POINT, result->point, sizeof result->point);
  memcpy(real + VR_FORCE, result->force, sizeof result->force);
  real[VR_SINKAGE] = c->v.first_height - result->point[model.up_axis];
  real[VR_DRAWBAR] = drawbar_of(real + VR_LINEAR, result->force, model.up_axis);
}

/* Says once when a kind of status begins. */
static void tell_status(component *c, int status, int frame) {
  static const char *const texts[] = {"the context lies outside the training runs",
                                      "the start lies outside the training runs",
                                      "the pose lies outside the training runs",
                                      "the speed lies outside the training runs",
                                      "the soil left the bounds of the training runs",
                                      "a position or force is not finite"};
  char text[96];
  for (int i = 0; i < 6; ++i) {
    if (!((status & ~c->v.told) >> i & 1)) continue;
    snprintf(text, sizeof text, "frame %d: %s", frame, texts[i]);
    log_text(c, fmi2Warning, "logStatusWarning", text);
  }
  c->v.told |= status;
}

/* Starts the model from the current values, once they have changed. */
static fmi2Status begin(component *c) {
  if (c->v.begun) return fmi2OK;
  const lts_pose pose = pose_of(&c->v);
  const lts_twist twist = twist_of(&c->v);
  lts_description model;
  lts_result result;
  lts_describe(&FMU_MODEL, &model);
  const int status = lts_start(c->soil, c->v.start, &pose, &twist, c->v.real + VR_CONTEXT);
  if (status < 0) return refuse(c, lts_error_text(status));
  memset(&result, 0, sizeof result);
  double points[3 * FMU_RIGID + 3];
  lts_points(c->soil, points);
  for (int i = 0; i < 3 * FMU_RIGID; ++i) result.point[i % 3] += points[i] / (FMU_RIGID + !FMU_RIGID);
  c->v.first_height = result.point[model.up_axis];
  c->v.told = 0;
  take_result(c, &result);
  tell_status(c, status, 0);
  c->v.begun = 1;
  return fmi2OK;
}

/* ---- life ---- */

FMI2_EXPORT const char *FMI2(fmi2GetTypesPlatform)(void) { return "default"; }
FMI2_EXPORT const char *FMI2(fmi2GetVersion)(void) { return "2.0"; }

static void set_defaults(component *c) {
  lts_pose pose;
  lts_description model;
  memset(&c->v, 0, sizeof c->v);
  lts_describe(&FMU_MODEL, &model);
  lts_start_pose(&FMU_MODEL, 0, &pose);
  memcpy(c->v.real + VR_POSITION, pose.position, sizeof pose.position);
  memcpy(c->v.real + VR_ROTATION, pose.rotation, sizeof pose.rotation);
  memcpy(c->v.real + VR_POINT, pose.position, sizeof pose.position);
  c->v.real[VR_FRAME_TIME] = model.dt;
  lts_start_context(&FMU_MODEL, 0, c->v.real + VR_CONTEXT);
  c->v.start = -1;
}

FMI2_EXPORT fmi2Component FMI2(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid,
                                                fmi2String resources,
                                                const fmi2CallbackFunctions *call,
                                                fmi2Boolean visible, fmi2Boolean logs) {
  (void)resources;
  (void)visible;
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
  /* One block: the component, its name, the model. */
  const size_t length = strlen(name) + 1, size = lts_size(&FMU_MODEL);
  char *block = (char *)call->allocateMemory(1, sizeof(component) + length + size);
  if (!block) {
    refuse(&probe, "out of memory");
    return NULL;
  }
  component *c = (component *)(void *)block;
  memcpy(block + sizeof *c, name, length);
  *c = probe;
  c->name = block + sizeof *c;
  c->logs = logs;
  if (lts_init(&FMU_MODEL, block + sizeof *c + length, size, LTS_BEST, &c->soil) < 0) {
    call->freeMemory(block);
    return NULL;
  }
  set_defaults(c);
  return c;
}

FMI2_EXPORT void FMI2(fmi2FreeInstance)(fmi2Component instance) {
  component *c = (component *)instance;
  if (c) c->call.freeMemory(c);
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetDebugLogging)(fmi2Component instance, fmi2Boolean on, size_t n,
                                                 const fmi2String categories[]) {
  (void)n;
  (void)categories;
  if (!instance) return fmi2Error;
  ((component *)instance)->logs = on;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetupExperiment)(fmi2Component instance, fmi2Boolean has_tolerance,
                                                 fmi2Real tolerance, fmi2Real start,
                                                 fmi2Boolean has_stop, fmi2Real stop) {
  component *c = (component *)instance;
  (void)has_tolerance;
  (void)tolerance;
  (void)has_stop;
  (void)stop;
  if (!c) return fmi2Error;
  if (c->v.now != CREATED) return refuse(c, "fmi2SetupExperiment after the initialisation");
  c->v.time = start;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2EnterInitializationMode)(fmi2Component instance) {
  component *c = (component *)instance;
  if (!c) return fmi2Error;
  if (c->v.now != CREATED) return refuse(c, "fmi2EnterInitializationMode is called twice");
  c->v.now = INITIALISING;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2ExitInitializationMode)(fmi2Component instance) {
  component *c = (component *)instance;
  if (!c) return fmi2Error;
  if (c->v.now != INITIALISING) return refuse(c, "fmi2ExitInitializationMode out of turn");
  const fmi2Status status = begin(c);
  if (status == fmi2OK) c->v.now = STEPPING;
  return status;
}

FMI2_EXPORT fmi2Status FMI2(fmi2Terminate)(fmi2Component instance) {
  component *c = (component *)instance;
  if (!c) return fmi2Error;
  c->v.now = TERMINATED;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2Reset)(fmi2Component instance) {
  component *c = (component *)instance;
  if (!c) return fmi2Error;
  set_defaults(c);
  return fmi2OK;
}

/* ---- variables ---- */

FMI2_EXPORT fmi2Status FMI2(fmi2GetReal)(fmi2Component instance, const fmi2ValueReference vr[],
                                         size_t n, fmi2Real value[]) {
  component *c = (component *)instance;
  if (!c || (n && (!vr || !value))) return fmi2Error;
  for (size_t i = 0; i < n; ++i) {
    if (vr[i] >= N_REAL) return refuse(c, "no real variable of this value reference");
    if (c->v.now == INITIALISING && vr[i] >= VR_POINT && vr[i] < VR_FRAME_TIME) {
      const fmi2Status status = begin(c);
      if (status != fmi2OK) return status;
    }
    value[i] = c->v.real[vr[i]];
  }
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetReal)(fmi2Component instance, const fmi2ValueReference vr[],
                                         size_t n, const fmi2Real value[]) {
  component *c = (component *)instance;
  if (!c || (n && (!vr || !value))) return fmi2Error;
  for (size_t i = 0; i < n; ++i) {
    const int is_input = vr[i] < VR_POINT, is_context = vr[i] >= VR_CONTEXT && vr[i] < N_REAL;
    if (!is_input && !is_context) return refuse(c, "this real variable cannot be set");
    if (is_context && c->v.now >= STEPPING) {
      return refuse(c, "a fixed parameter is set after the initialisation");
    }
    if (!isfinite(value[i])) return refuse(c, "an input or parameter is not finite");
  }
  for (size_t i = 0; i < n; ++i) c->v.real[vr[i]] = value[i];
  if (c->v.now < STEPPING) c->v.begun = 0;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetInteger)(fmi2Component instance, const fmi2ValueReference vr[],
                                            size_t n, fmi2Integer value[]) {
  component *c = (component *)instance;
  if (!c || (n && (!vr || !value))) return fmi2Error;
  for (size_t i = 0; i < n; ++i) {
    if (vr[i]) return refuse(c, "no integer variable of this value reference");
    value[i] = c->v.start;
  }
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetInteger)(fmi2Component instance, const fmi2ValueReference vr[],
                                            size_t n, const fmi2Integer value[]) {
  component *c = (component *)instance;
  if (!c || (n && (!vr || !value))) return fmi2Error;
  for (size_t i = 0; i < n; ++i) {
    if (vr[i]) return refuse(c, "no integer variable of this value reference");
    if (c->v.now >= STEPPING) return refuse(c, "a fixed parameter is set after the initialisation");
    lts_description model;
    lts_describe(&FMU_MODEL, &model);
    if (value[i] < -1 || value[i] >= model.n_start) return refuse(c, "the model has no such start");
    c->v.start = value[i];
    c->v.begun = 0;
  }
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetBoolean)(fmi2Component instance, const fmi2ValueReference vr[],
                                            size_t n, fmi2Boolean value[]) {
  component *c = (component *)instance;
  if (!c || (n && (!vr || !value))) return fmi2Error;
  if (c->v.now == INITIALISING && begin(c) != fmi2OK) return fmi2Error;
  const int status = c->v.told;
  for (size_t i = 0; i < n; ++i) {
    if (vr[i] >= N_BOOLEAN) return refuse(c, "no boolean variable of this value reference");
    const int bits[N_BOOLEAN] = {0, LTS_EXTRAPOLATING, LTS_LEFT_BOUNDS, LTS_NON_FINITE};
    value[i] = vr[i] ? (status & bits[vr[i]]) != 0 : !status;
  }
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetBoolean)(fmi2Component instance, const fmi2ValueReference vr[],
                                            size_t n, const fmi2Boolean value[]) {
  (void)vr;
  (void)value;
  if (!instance) return fmi2Error;
  return n ? refuse((component *)instance, "no boolean variable can be set") : fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetString)(fmi2Component instance, const fmi2ValueReference vr[],
                                           size_t n, fmi2String value[]) {
  component *c = (component *)instance;
  lts_description model;
  if (!c || (n && (!vr || !value))) return fmi2Error;
  lts_describe(&FMU_MODEL, &model);
  for (size_t i = 0; i < n; ++i) {
    if (vr[i]) return refuse(c, "no string variable of this value reference");
    value[i] = model.digest;
  }
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetString)(fmi2Component instance, const fmi2ValueReference vr[],
                                           size_t n, const fmi2String value[]) {
  (void)vr;
  (void)value;
  if (!instance) return fmi2Error;
  return n ? refuse((component *)instance, "no string variable can be set") : fmi2OK;
}

/* ---- steps ---- */

FMI2_EXPORT fmi2Status FMI2(fmi2DoStep)(fmi2Component instance, fmi2Real time, fmi2Real h,
                                        fmi2Boolean no_set_state) {
  component *c = (component *)instance;
  (void)no_set_state;
  if (!c) return fmi2Error;
  if (c->v.now != STEPPING) return refuse(c, "fmi2DoStep before the end of the initialisation");
  if (!(h > 0.0) || !isfinite(time)) return refuse(c, "the step has no positive length");
  const lts_pose pose = pose_of(&c->v);
  const lts_twist twist = twist_of(&c->v);
  lts_result result;
  const int status =
      lts_advance(c->soil, h, FMU_GIVEN ? &pose : NULL, FMU_GIVEN ? &twist : NULL, &result);
  if (status < 0) return refuse(c, lts_error_text(status));
  c->v.time = time + h;
  take_result(c, &result);
  tell_status(c, status, result.frame);
  if (status & LTS_NON_FINITE) return refuse(c, "the soil has left all numbers");
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2CancelStep)(fmi2Component instance) {
  return instance ? refuse((component *)instance, "steps are never pending") : fmi2Error;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetRealInputDerivatives)(fmi2Component instance,
                                                         const fmi2ValueReference vr[], size_t n,
                                                         const fmi2Integer order[],
                                                         const fmi2Real value[]) {
  (void)vr;
  (void)order;
  (void)value;
  if (!instance) return fmi2Error;
  return n ? refuse((component *)instance, "the velocities are inputs; derivatives are not taken")
           : fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetRealOutputDerivatives)(fmi2Component instance,
                                                          const fmi2ValueReference vr[], size_t n,
                                                          const fmi2Integer order[],
                                                          fmi2Real value[]) {
  (void)vr;
  (void)order;
  (void)value;
  if (!instance) return fmi2Error;
  return n ? refuse((component *)instance, "outputs have no derivatives") : fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetDirectionalDerivative)(
    fmi2Component instance, const fmi2ValueReference unknown[], size_t n_unknown,
    const fmi2ValueReference known[], size_t n_known, const fmi2Real d_known[],
    fmi2Real d_unknown[]) {
  (void)unknown;
  (void)n_unknown;
  (void)known;
  (void)n_known;
  (void)d_known;
  (void)d_unknown;
  return instance ? refuse((component *)instance, "no directional derivatives") : fmi2Error;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetStatus)(fmi2Component instance, const fmi2StatusKind kind,
                                           fmi2Status *value) {
  (void)kind;
  if (!instance || !value) return fmi2Error;
  *value = fmi2OK;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetRealStatus)(fmi2Component instance, const fmi2StatusKind kind,
                                               fmi2Real *value) {
  if (!instance || !value) return fmi2Error;
  if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
  *value = ((component *)instance)->v.time;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetIntegerStatus)(fmi2Component instance, const fmi2StatusKind kind,
                                                  fmi2Integer *value) {
  (void)kind;
  (void)value;
  return instance ? fmi2Discard : fmi2Error;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetBooleanStatus)(fmi2Component instance, const fmi2StatusKind kind,
                                                  fmi2Boolean *value) {
  if (!instance || !value) return fmi2Error;
  if (kind != fmi2Terminated) return fmi2Discard;
  *value = 0;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetStringStatus)(fmi2Component instance, const fmi2StatusKind kind,
                                                 fmi2String *value) {
  (void)kind;
  (void)value;
  return instance ? fmi2Discard : fmi2Error;
}

/* ---- state: its values, then the bytes of lts_save ---- */

static size_t state_size(void) { return sizeof(values) + lts_state_size(&FMU_MODEL); }

static fmi2Status write_state(component *c, char *bytes) {
  memcpy(bytes, &c->v, sizeof c->v);
  const int code = lts_save(c->soil, bytes + sizeof c->v, lts_state_size(&FMU_MODEL));
  return code < 0 ? refuse(c, lts_error_text(code)) : fmi2OK;
}

static fmi2Status read_state(component *c, const char *bytes) {
  const int code = lts_load(c->soil, bytes + sizeof c->v, lts_state_size(&FMU_MODEL));
  if (code < 0) return refuse(c, lts_error_text(code));
  memcpy(&c->v, bytes, sizeof c->v);
  if (c->v.start < -1) c->v.start = -1; /* of forged bytes; lts_start refuses what is too large */
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2GetFMUstate)(fmi2Component instance, fmi2FMUstate *state) {
  component *c = (component *)instance;
  if (!c || !state) return fmi2Error;
  if (!*state) *state = c->call.allocateMemory(1, state_size());
  if (!*state) return refuse(c, "out of memory");
  return write_state(c, (char *)*state);
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetFMUstate)(fmi2Component instance, fmi2FMUstate state) {
  return instance && state ? read_state((component *)instance, (const char *)state) : fmi2Error;
}

FMI2_EXPORT fmi2Status FMI2(fmi2FreeFMUstate)(fmi2Component instance, fmi2FMUstate *state) {
  component *c = (component *)instance;
  if (!c || !state) return fmi2Error;
  if (*state) c->call.freeMemory(*state);
  *state = NULL;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SerializedFMUstateSize)(fmi2Component instance, fmi2FMUstate state,
                                                        size_t *size) {
  if (!instance || !state || !size) return fmi2Error;
  *size = state_size();
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2SerializeFMUstate)(fmi2Component instance, fmi2FMUstate state,
                                                   fmi2Byte bytes[], size_t size) {
  if (!instance || !state || !bytes || size < state_size()) return fmi2Error;
  memcpy(bytes, state, state_size());
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2DeSerializeFMUstate)(fmi2Component instance, const fmi2Byte bytes[],
                                                     size_t size, fmi2FMUstate *state) {
  component *c = (component *)instance;
  if (!c || !bytes || !state) return fmi2Error;
  if (size != state_size()) return refuse(c, "the bytes are no state of this FMU");
  if (!*state) *state = c->call.allocateMemory(1, size);
  if (!*state) return refuse(c, "out of memory");
  memcpy(*state, bytes, size);
  return fmi2OK;
}
