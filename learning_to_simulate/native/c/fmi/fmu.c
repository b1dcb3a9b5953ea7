/* An FMU of FMI 2.0 for co-simulation: a soil field with FMU_TOOLS tools on a terrain of parameters that begins level.
 * A communication step is a step of the model, however long. Written against the standard's text; its types and
 * functions are declared here, so that no header has to be fetched. Functions of the model return null, or what is
 * wrong. */
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include "fmu_model.h" /* generated: the model, its GUID, its tools and variables */
#include "lts_common.h"

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

/* ---- variables and state ---- */

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
  VR_PAYLOAD,
  VR_HEIGHTS,
  VR_SHAPE = VR_HEIGHTS + FMU_ALONG * FMU_ACROSS, /* the first parameter: lts_soil_tool */
  VR_TOOL = VR_SHAPE + sizeof(lts_soil_tool) / sizeof(double)
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
enum { FMU_NONE, FMU_INPUT, FMU_OUTPUT, FMU_PARAMETER };

enum { N_BOOLEAN = 4 }; /* of a tool: ok, ok_now, extrapolating, non_finite */

/* What a saved state begins with. */
typedef struct {
  fmu_phase now;
  int begun; /* whether the model has been started from the current values */
  double time;
  double h;            /* of the last step, s */
  int told[FMU_TOOLS]; /* status bits that have held since the start */
  double real[N_REAL];
} fmu_values;

typedef struct {
  lts_terrain ground;
  void *memory[FMU_TOOLS];
  lts_soil *soil[FMU_TOOLS];
  int shown[FMU_TOOLS]; /* whether heights are those of now */
  double *built; /* reals that it was built for */
  char text[FMU_TOOLS][200], wrong[200];
} fmu_model;

typedef struct {
  fmu_values v;
  fmu_model model;
  fmi2CallbackFunctions call;
  fmi2String name;
  int logs;
} component;

#define MOST_CELLS 1e8
#define REACH 1e-4 /* of differences, m */

static const double first_values[N_REAL] = FMU_FIRST;
static const unsigned char kinds[N_REAL] = FMU_KINDS;

static void log_text(component *c, fmi2Status status, fmi2String category, fmi2String text) {
  if (c->call.logger && (c->logs || status >= fmi2Error)) {
    /* No text has a % in it: importers differ in whether they expand formats. */
    c->call.logger(c->call.componentEnvironment, c->name, status, category, text);
  }
}

static double *of_tool(component *c, int tool) { return c->v.real + tool * VR_TOOL; }

/* The tool of a real variable, and which of its reals that is; -1 for one of the ground. */
static int tool_of(unsigned vr, int *which) {
  *which = (int)(vr % VR_TOOL);
  return vr < VR_GROUND ? (int)(vr / VR_TOOL) : -1;
}

/* What is wrong with a tool, in words. */
static const char *say(component *c, int tool, int code) {
  snprintf(c->model.wrong, sizeof c->model.wrong, "tool %d: %s", tool + 1, lts_error_text(code));
  return c->model.wrong;
}

/* ---- terrain and tools ---- */

static void release(component *c) {
  fmu_model *m = &c->model;
  for (int k = 0; k < FMU_TOOLS; ++k) {
    if (m->soil[k]) lts_soil_close(m->soil[k]);
    if (m->memory[k]) c->call.freeMemory(m->memory[k]);
  }
  if (m->ground.heights) c->call.freeMemory(m->ground.heights);
  if (m->built) c->call.freeMemory(m->built);
  memset(m, 0, sizeof *m);
}

/* Makes a level terrain and tools that stand nowhere yet. */
static const char *build(component *c) {
  const double *real = c->v.real;
  fmu_model *m = &c->model;
  lts_terrain *t = &m->ground;
  release(c);
  double n[2];
  for (int i = 0; i < 2; ++i) {
    n[i] = rint(real[VR_SIZE + i] / real[VR_CELL]);
    t->cell[i] = real[VR_CELL];
    if (!(real[VR_CELL] > 0.0 && n[i] >= 1.0 && n[i] <= MOST_CELLS)) return "the terrain has no cells, or too many";
    t->n[i] = (int32_t)n[i];
  }
  if (!(n[0] * n[1] <= MOST_CELLS)) return "the terrain has too many cells";
  if (!(real[VR_DEPTH] >= 0.0)) return "the depth of the soil is negative";
  const size_t cells = (size_t)t->n[0] * (size_t)t->n[1];
  t->floor = real[VR_HEIGHT] - real[VR_DEPTH];
  t->friction_angle_deg = real[VR_FRICTION];
  t->density = real[VR_DENSITY];
  t->gravity = real[VR_GRAVITY];
  t->heights = c->call.allocateMemory(cells, sizeof *t->heights);
  m->built = c->call.allocateMemory(N_REAL, sizeof *m->built);
  if (!t->heights || !m->built) return "out of memory";
  for (size_t i = 0; i < cells; ++i) t->heights[i] = real[VR_HEIGHT];
  memcpy(m->built, real, N_REAL * sizeof *real);
  for (int k = 0; k < FMU_TOOLS; ++k) {
    const double *shape = of_tool(c, k) + VR_SHAPE;
    lts_soil_tool tool;
    memcpy(&tool, shape, sizeof tool);
    const size_t size = lts_soil_size(&FMU_MODEL, &tool, t);
    if (!size) return say(c, k, LTS_ERROR_VALUE);
    m->memory[k] = c->call.allocateMemory(1, size);
    if (!m->memory[k]) return "out of memory";
    const int code = lts_soil_init(&FMU_MODEL, &tool, t, m->memory[k], size, LTS_BEST, &m->soil[k]);
    if (code < 0) return say(c, k, code);
  }
  return NULL;
}

/* Whether what is there was built for the parameters of now. */
static int is_built(component *c) {
  const fmu_model *m = &c->model;
  const double *real = c->v.real;
  if (!m->built || !m->soil[FMU_TOOLS - 1]) return 0;
  for (int k = 0; k < FMU_TOOLS; ++k) {
    const int at = k * VR_TOOL + VR_SHAPE;
    if (memcmp(m->built + at, real + at, (VR_TOOL - VR_SHAPE) * sizeof *real)) return 0;
  }
  return !memcmp(m->built + VR_GROUND, real + VR_GROUND, (VR_GRID - VR_GROUND) * sizeof *real);
}

/* ---- frames ---- */

static void take(component *c, int tool, const lts_soil_result *r) {
  double *real = of_tool(c, tool), place[9];
  memcpy(real + VR_POINT, r->pose.position, 3 * sizeof(double));
  memcpy(real + VR_FORCE, r->force, sizeof r->force);
  memcpy(real + VR_MOMENT, r->torque, sizeof r->torque);
  memcpy(real + VR_SPREAD, r->spread, sizeof r->spread);
  real[VR_BOUND] = isfinite(r->bound) ? r->bound : -1.0;
  real[VR_SINKAGE] = c->v.real[VR_HEIGHT] - (r->pose.position[1] - real[VR_SHAPE + 1]);
  lts_soil_place(c->model.soil[tool], place);
  real[VR_DRAWBAR] = place[3] * r->force[0] + place[5] * r->force[2];
  real[VR_PAYLOAD] = r->payload;
  c->model.shown[tool] = 0;
  const int fresh = r->now.status & ~c->v.told[tool];
  c->v.told[tool] |= r->now.status;
  if (!fresh) return;
  char text[300], why[200];
  lts_soil_reason(c->model.soil[tool], &r->now, why, sizeof why);
  snprintf(text, sizeof text, "tool %d, frame %d: %s", tool + 1, r->frame, why);
  log_text(c, fmi2Warning, "logStatusWarning", text);
}

/* Heights about a tool, as all tools have left them. */
static void show(component *c, unsigned vr) {
  int which;
  const int tool = tool_of(vr, &which);
  if (which < VR_HEIGHTS || c->model.shown[tool]) return;
  double place[9], *real = of_tool(c, tool), *to = real + VR_HEIGHTS;
  const double side = c->v.real[VR_GRID];
  lts_terrain_update(&c->model.ground);
  lts_soil_place(c->model.soil[tool], place);
  for (int i = 0; i < FMU_ALONG; ++i) {
    for (int j = 0; j < FMU_ACROSS; ++j) {
      const double u = side * (i - FMU_ALONG / 2), across = side * (j - FMU_ACROSS / 2);
      *to++ = lts_terrain_at(&c->model.ground, real[VR_POINT] + u * place[3] + across * place[6],
                             real[VR_POINT + 2] + u * place[5] + across * place[8]);
    }
  }
  c->model.shown[tool] = 1;
}

/* Where the pose of a tool whose inputs are reals from `inputs` on leads in h s: a model wants the coming pose. */
static lts_pose coming(const double *inputs, double h) {
  lts_pose pose;
  lts_twist twist;
  memcpy(pose.position, inputs + VR_POSITION, sizeof pose.position);
  memcpy(pose.rotation, inputs + VR_ROTATION, sizeof pose.rotation);
  memcpy(twist.linear, inputs + VR_LINEAR, sizeof twist.linear);
  memcpy(twist.angular, inputs + VR_ANGULAR, sizeof twist.angular);
  lts_moved_pose(&pose, &twist, h, &pose);
  return pose;
}

/* Starts the model from the current values, once they have changed. */
static const char *begin(component *c) {
  if (c->v.begun) return NULL;
  const char *wrong = build(c);
  for (int k = 0; k < FMU_TOOLS && !wrong; ++k) {
    const lts_pose pose = coming(of_tool(c, k), 0.0);
    lts_soil_result result;
    const int code = lts_soil_start(c->model.soil[k], &pose, &result);
    c->v.told[k] = 0;
    if (code < 0) wrong = say(c, k, code);
    if (!wrong) take(c, k, &result);
  }
  c->v.begun = !wrong;
  return wrong;
}

/* Starts the model for whoever looks at an output before the first step. */
static const char *begin_early(component *c) { return c->v.now == FMU_INITIALISING ? begin(c) : NULL; }

static const char *go(component *c, double h) {
  lts_pose pose[FMU_TOOLS];
  lts_soil_result result;
  int code = LTS_OK;
  if (!c->v.begun) return "the state that was to be restored is none";
  for (int k = 0; k < FMU_TOOLS; ++k) {
    pose[k] = coming(of_tool(c, k), h);
    /* One that is refused must not come after others that have moved. */
    if (FMU_TOOLS > 1) code = lts_soil_propose(c->model.soil[k], &pose[k], h, NULL);
    if (code < 0) return say(c, k, code);
  }
  for (int k = 0; k < FMU_TOOLS; ++k) {
    code = lts_soil_step(c->model.soil[k], &pose[k], h, &result);
    if (code < 0) return say(c, k, code);
    take(c, k, &result);
    if (result.now.status & LTS_NON_FINITE) return "the soil has left all numbers";
  }
  c->v.h = h;
  return NULL;
}

static const char *derivative(component *c, const unsigned *unknown, size_t n_unknown, const unsigned *known,
                           size_t n_known, const double *d_known, double *d_unknown) {
  double seed[FMU_TOOLS][13] = {{0.0}}, found[FMU_TOOLS][6] = {{0.0}};
  int which;
  const char *wrong = begin(c);
  if (wrong) return wrong;
  for (size_t i = 0; i < n_known; ++i) {
    const int k = tool_of(known[i], &which);
    if (k < 0 || which >= VR_POINT) return "derivatives are by inputs";
    if (!isfinite(d_known[i])) return "a seed is not finite";
    seed[k][which] += d_known[i];
  }
  for (size_t i = 0; i < n_unknown; ++i) {
    const int k = tool_of(unknown[i], &which);
    if (k < 0 || which < VR_FORCE || which >= VR_SPREAD) return "derivatives are those of forces and moments";
  }
  for (int k = 0; k < FMU_TOOLS; ++k) {
    double size[4] = {0.0}, inputs[13];
    for (int i = 0; i < 13; ++i) {
      const int part = i < VR_ROTATION ? 0 : i < VR_LINEAR ? 1 : i < VR_ANGULAR ? 2 : 3;
      size[part] = hypot(size[part], seed[k][i]);
    }
    /* How far the coming pose goes; a tenth of a rad counts as a cm. */
    const double way = size[0] + c->v.h * size[2] + 0.1 * (2.0 * size[1] + c->v.h * size[3]);
    if (!(way > 0.0)) continue;
    lts_soil_result ends[2];
    for (int end = 0; end < 2; ++end) {
      for (int i = 0; i < 13; ++i) inputs[i] = of_tool(c, k)[i] + (end ? -REACH : REACH) / way * seed[k][i];
      const lts_pose pose = coming(inputs, c->v.h);
      const int code = lts_soil_propose(c->model.soil[k], &pose, c->v.h, &ends[end]);
      if (code < 0) return say(c, k, code);
    }
    for (int i = 0; i < 3; ++i) {
      found[k][i] = (ends[0].force[i] - ends[1].force[i]) / (2.0 * REACH / way);
      found[k][3 + i] = (ends[0].torque[i] - ends[1].torque[i]) / (2.0 * REACH / way);
    }
  }
  for (size_t i = 0; i < n_unknown; ++i) {
    const int k = tool_of(unknown[i], &which);
    d_unknown[i] = found[k][which - VR_FORCE];
  }
  return NULL;
}

/* ---- variables ---- */

/* The newest frame of a tool; of one that stands nowhere all is well. */
static const char *newest(component *c, int tool, lts_soil_result *result) {
  memset(result, 0, sizeof *result);
  result->worst.axis = -1;
  const char *wrong = begin_early(c);
  if (!wrong && c->v.begun) lts_soil_newest(c->model.soil[tool], result);
  return wrong;
}

static const char *get_integer(component *c, unsigned vr, int *value) {
  lts_soil_result result;
  if (vr >= FMU_TOOLS) return "no integer variable of this value reference";
  const char *wrong = newest(c, (int)vr, &result);
  *value = result.worst.status & LTS_NON_FINITE ? -1 : result.worst.axis + 1;
  return wrong;
}

static const char *get_boolean(component *c, unsigned vr, int *value) {
  lts_soil_result result;
  if (vr >= FMU_TOOLS * N_BOOLEAN) return "no Boolean variable of this value reference";
  const int tool = (int)vr / N_BOOLEAN;
  const char *wrong = newest(c, tool, &result);
  const int told = c->v.told[tool];
  const int values[N_BOOLEAN] = {!told, !result.now.status, (told & LTS_EXTRAPOLATING) != 0,
                                 (told & LTS_NON_FINITE) != 0};
  *value = values[vr % N_BOOLEAN];
  return wrong;
}

static const char *get_string(component *c, unsigned vr, const char **value) {
  lts_soil_result result;
  lts_soil_description model;
  if (vr > FMU_TOOLS) return "no string variable of this value reference";
  if (!vr) {
    lts_soil_describe(&FMU_MODEL, &model);
    *value = model.digest;
    return NULL;
  }
  const int tool = (int)vr - 1;
  char *text = c->model.text[tool];
  const char *wrong = newest(c, tool, &result);
  text[0] = '\0';
  if (!wrong && c->v.begun) lts_soil_reason(c->model.soil[tool], &result.worst, text, sizeof c->model.text[tool]);
  *value = text;
  return wrong;
}

/* ---- state: values, heights, tools ---- */

static size_t heights_size(const component *c) {
  return (size_t)c->model.ground.n[0] * (size_t)c->model.ground.n[1] * sizeof(double);
}

static size_t state_size(const component *c) {
  size_t size = sizeof c->v;
  if (!c->v.begun) return size;
  for (int k = 0; k < FMU_TOOLS; ++k) size += sizeof size + lts_soil_state_size(c->model.soil[k]);
  return size + heights_size(c);
}

static const char *write_state(component *c, void *bytes) {
  char *to = (char *)bytes;
  memcpy(to, &c->v, sizeof c->v);
  to += sizeof c->v;
  if (!c->v.begun) return NULL;
  memcpy(to, c->model.ground.heights, heights_size(c));
  to += heights_size(c);
  for (int k = 0; k < FMU_TOOLS; ++k) {
    const size_t size = lts_soil_state_size(c->model.soil[k]);
    memcpy(to, &size, sizeof size);
    const int code = lts_soil_save(c->model.soil[k], to + sizeof size, size);
    if (code < 0) return say(c, k, code);
    to += sizeof size + size;
  }
  return NULL;
}

static const char *read_state(component *c, const void *bytes, size_t size) {
  static const char *const none = "the bytes are no state of this FMU";
  const char *from = (const char *)bytes, *end = from + size;
  if (size < sizeof c->v) return none;
  memcpy(&c->v, from, sizeof c->v);
  from += sizeof c->v;
  if (!c->v.begun) return NULL;
  c->v.begun = 0; /* until all of it is there */
  const char *wrong = is_built(c) ? NULL : build(c);
  if (wrong) return wrong;
  if ((size_t)(end - from) < heights_size(c)) return none;
  memcpy(c->model.ground.heights, from, heights_size(c));
  from += heights_size(c);
  for (int k = 0; k < FMU_TOOLS; ++k) {
    size_t n;
    if ((size_t)(end - from) < sizeof n) return none;
    memcpy(&n, from, sizeof n);
    from += sizeof n;
    if ((size_t)(end - from) < n) return none;
    const int code = lts_soil_restore(c->model.soil[k], from, n);
    if (code < 0) return say(c, k, code);
    from += n;
    c->model.shown[k] = 0;
  }
  c->v.begun = 1;
  return NULL;
}

/* ---- the standard ---- */

static fmi2Status refuse(component *c, fmi2String text) {
  log_text(c, fmi2Error, "logStatusError", text);
  return fmi2Error;
}

/* What a function of the model says. */
static fmi2Status done(component *c, const char *wrong) { return wrong ? refuse(c, wrong) : fmi2OK; }

/* ---- life ---- */

static void make_default(component *c) {
  memset(&c->v, 0, sizeof c->v);
  memcpy(c->v.real, first_values, sizeof first_values);
  c->v.h = FMU_STEP;
  release(c);
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
  make_default(c);
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
  release(c);
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
  if (c->v.now != FMU_CREATED) {
    return refuse(c, "fmi2SetupExperiment after the initialisation");
  }
  c->v.time = start;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2EnterInitializationMode)(fmi2Component instance) {
  OPEN(c);
  if (c->v.now != FMU_CREATED) return refuse(c, "the initialisation is entered twice");
  c->v.now = FMU_INITIALISING;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2ExitInitializationMode)(fmi2Component instance) {
  OPEN(c);
  if (c->v.now != FMU_INITIALISING) return refuse(c, "the initialisation is left out of turn");
  const char *wrong = begin(c);
  if (!wrong) c->v.now = FMU_STEPPING;
  return done(c, wrong);
}

FMI2_EXPORT fmi2Status FMI2(fmi2Terminate)(fmi2Component instance) {
  OPEN(c);
  c->v.now = FMU_TERMINATED;
  return fmi2OK;
}

FMI2_EXPORT fmi2Status FMI2(fmi2Reset)(fmi2Component instance) {
  OPEN(c);
  make_default(c);
  return fmi2OK;
}

/* ---- variables ---- */

static const char *get_real(component *c, fmi2ValueReference vr, double *value) {
  if (vr >= N_REAL) return "no real variable of this value reference";
  if (kinds[vr] == FMU_OUTPUT) {
    const char *wrong = begin_early(c);
    if (wrong) return wrong;
    if (c->v.begun) show(c, vr);
  }
  *value = c->v.real[vr];
  return NULL;
}

/* Whether a real can be set, and to a value. */
static const char *check_real(const component *c, fmi2ValueReference vr, double value) {
  const int kind = vr < N_REAL ? kinds[vr] : FMU_NONE;
  if (kind != FMU_INPUT && kind != FMU_PARAMETER) return "this real variable cannot be set";
  if (kind == FMU_PARAMETER && c->v.now >= FMU_STEPPING) return "a fixed parameter is set after the initialisation";
  return isfinite(value) ? NULL : "an input or parameter is not finite";
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetReal)(fmi2Component instance, const fmi2ValueReference vr[],
                                         size_t n, const fmi2Real value[]) {
  OPEN_VALUES(c);
  const char *wrong = NULL;
  for (size_t i = 0; i < n && !wrong; ++i) wrong = check_real(c, vr[i], value[i]);
  if (wrong) return refuse(c, wrong); /* none is set */
  for (size_t i = 0; i < n; ++i) c->v.real[vr[i]] = value[i];
  if (c->v.now < FMU_STEPPING) c->v.begun = 0;
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
EACH(fmi2GetReal, fmi2Real, get_real(c, vr[i], &value[i]))
EACH(fmi2GetInteger, fmi2Integer, get_integer(c, vr[i], &value[i]))
EACH(fmi2SetInteger, const fmi2Integer, "no integer variable can be set")
EACH(fmi2GetBoolean, fmi2Boolean, get_boolean(c, vr[i], &value[i]))
EACH(fmi2SetBoolean, const fmi2Boolean, "no boolean variable can be set")
EACH(fmi2GetString, fmi2String, get_string(c, vr[i], &value[i]))
EACH(fmi2SetString, const fmi2String, "no string variable can be set")

/* ---- steps ---- */

FMI2_EXPORT fmi2Status FMI2(fmi2DoStep)(fmi2Component instance, fmi2Real time, fmi2Real h,
                                        fmi2Boolean no_set_state) {
  OPEN(c);
  if (c->v.now != FMU_STEPPING) return refuse(c, "a step before the end of the initialisation");
  if (!(h > 0.0) || !isfinite(time)) return refuse(c, "the step has no positive length");
  const char *wrong = go(c, h);
  if (!wrong) c->v.time = time + h;
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
  return done(c, derivative(c, unknown, n_unknown, known, n_known, d_known, d_unknown));
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
GET_STATUS(fmi2GetRealStatus, fmi2Real, kind == fmi2LastSuccessfulTime, c->v.time)
GET_STATUS(fmi2GetIntegerStatus, fmi2Integer, 0, 0)
GET_STATUS(fmi2GetBooleanStatus, fmi2Boolean, kind == fmi2Terminated, 0)
GET_STATUS(fmi2GetStringStatus, fmi2String, 0, "")

/* ---- state: its size, then the bytes of the component ---- */

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
  const fmi2Status status = room_for(c, state_size(c), state);
  if (status != fmi2OK) return status;
  return done(c, write_state(c, (char *)*state + sizeof(size_t)));
}

FMI2_EXPORT fmi2Status FMI2(fmi2SetFMUstate)(fmi2Component instance, fmi2FMUstate state) {
  OPEN(c);
  size_t size;
  if (!state) return fmi2Error;
  memcpy(&size, state, sizeof size);
  return done(c, read_state(c, (const char *)state + sizeof size, size));
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
