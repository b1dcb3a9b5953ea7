/* The model of an FMU: a soil field, with one or several tools on a terrain of parameters. A communication step is a
 * step of the model, however long. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "fmu_core.h"
#include "lts_common.h"

#define MOST_CELLS 1e8
#define REACH 1e-4 /* of differences, m */

static double *of_tool(fmu_core *c, int tool) { return c->v.real + tool * VR_TOOL; }

/* The tool of a real variable, and which of its reals that is; -1 for one of the ground. */
static int tool_of(unsigned vr, int *which) {
  *which = (int)(vr % VR_TOOL);
  return vr < VR_GROUND ? (int)(vr / VR_TOOL) : -1;
}

/* What is wrong with a tool, in words. */
static const char *say(fmu_core *c, int tool, int code) {
  snprintf(c->model.wrong, sizeof c->model.wrong, "tool %d: %s", tool + 1, lts_error_text(code));
  return c->model.wrong;
}

/* ---- terrain and tools ---- */

const char *fmu_make(fmu_core *c) {
  memset(&c->model, 0, sizeof c->model);
  return NULL;
}

void fmu_free(fmu_core *c) {
  fmu_model *m = &c->model;
  for (int k = 0; k < FMU_TOOLS; ++k) {
    if (m->soil[k]) lts_soil_close(m->soil[k]);
    if (m->memory[k]) c->release(m->memory[k]);
  }
  if (m->ground.heights) c->release(m->ground.heights);
  if (m->built) c->release(m->built);
  memset(m, 0, sizeof *m);
}

/* Makes a level terrain and tools that stand nowhere yet. */
static const char *build(fmu_core *c) {
  const double *real = c->v.real;
  fmu_model *m = &c->model;
  lts_terrain *t = &m->ground;
  fmu_free(c);
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
  t->heights = c->allocate(cells, sizeof *t->heights);
  m->built = c->allocate(N_REAL, sizeof *m->built);
  if (!t->heights || !m->built) return "out of memory";
  for (size_t i = 0; i < cells; ++i) t->heights[i] = real[VR_HEIGHT];
  memcpy(m->built, real, N_REAL * sizeof *real);
  for (int k = 0; k < FMU_TOOLS; ++k) {
    const double *shape = of_tool(c, k) + VR_SHAPE;
    const lts_soil_tool tool = {shape[0], shape[1], shape[2], shape[3], shape[4], shape[5], shape[6]};
    const size_t size = lts_soil_size(&FMU_MODEL, &tool, t);
    if (!size) return say(c, k, LTS_ERROR_VALUE);
    m->memory[k] = c->allocate(1, size);
    if (!m->memory[k]) return "out of memory";
    const int code = lts_soil_init(&FMU_MODEL, &tool, t, m->memory[k], size, LTS_BEST, &m->soil[k]);
    if (code < 0) return say(c, k, code);
  }
  return NULL;
}

/* Whether what is there was built for the parameters of now. */
static int is_built(fmu_core *c) {
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

static void take(fmu_core *c, int tool, const lts_soil_result *r) {
  double *real = of_tool(c, tool), place[9];
  memcpy(real + VR_POINT, r->pose.position, 3 * sizeof(double));
  memcpy(real + VR_FORCE, r->force, sizeof r->force);
  memcpy(real + VR_MOMENT, r->torque, sizeof r->torque);
  memcpy(real + VR_SPREAD, r->spread, sizeof r->spread);
  real[VR_BOUND] = isfinite(r->bound) ? r->bound : -1.0;
  real[VR_SINKAGE] = c->v.real[VR_HEIGHT] - (r->pose.position[1] - real[VR_SHAPE + 1]);
  lts_soil_place(c->model.soil[tool], place);
  real[VR_DRAWBAR] = place[3] * r->force[0] + place[5] * r->force[2];
  c->model.shown[tool] = 0;
  const int fresh = r->now.status & ~c->v.own.told[tool];
  c->v.own.told[tool] |= r->now.status;
  if (!fresh) return;
  char text[300], why[200];
  lts_soil_reason(c->model.soil[tool], &r->now, why, sizeof why);
  snprintf(text, sizeof text, "tool %d, frame %d: %s", tool + 1, r->frame, why);
  c->warn(c, text);
}

/* Heights about a tool, as all tools have left them. */
void fmu_show(fmu_core *c, unsigned vr) {
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

/* Where the pose of inputs leads in h s. */
static lts_pose coming(const double inputs[13], double h) {
  lts_pose pose = fmu_pose(inputs);
  const lts_twist twist = fmu_twist(inputs);
  lts_moved_pose(&pose, &twist, h, &pose);
  return pose;
}

const char *fmu_begin(fmu_core *c) {
  if (c->v.begun) return NULL;
  const char *wrong = build(c);
  for (int k = 0; k < FMU_TOOLS && !wrong; ++k) {
    const lts_pose pose = coming(of_tool(c, k), 0.0);
    lts_soil_result result;
    const int code = lts_soil_start(c->model.soil[k], &pose, &result);
    c->v.own.told[k] = 0;
    if (code < 0) wrong = say(c, k, code);
    if (!wrong) take(c, k, &result);
  }
  c->v.begun = !wrong;
  return wrong;
}

const char *fmu_go(fmu_core *c, double h) {
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
  c->v.own.h = h;
  return NULL;
}

const char *fmu_derivative(fmu_core *c, const unsigned *unknown, size_t n_unknown, const unsigned *known,
                           size_t n_known, const double *d_known, double *d_unknown) {
  double seed[FMU_TOOLS][13] = {{0.0}}, found[FMU_TOOLS][6] = {{0.0}};
  int which;
  const char *wrong = fmu_begin(c);
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
    const double way = size[0] + c->v.own.h * size[2] + 0.1 * (2.0 * size[1] + c->v.own.h * size[3]);
    if (!(way > 0.0)) continue;
    lts_soil_result ends[2];
    for (int end = 0; end < 2; ++end) {
      for (int i = 0; i < 13; ++i) inputs[i] = of_tool(c, k)[i] + (end ? -REACH : REACH) / way * seed[k][i];
      const lts_pose pose = coming(inputs, c->v.own.h);
      const int code = lts_soil_propose(c->model.soil[k], &pose, c->v.own.h, &ends[end]);
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

void fmu_clear(fmu_core *c) {
  fmu_free(c);
  c->v.own.h = FMU_STEP;
}

/* The newest frame of a tool; of one that stands nowhere all is well. */
static const char *newest(fmu_core *c, int tool, lts_soil_result *result) {
  memset(result, 0, sizeof *result);
  result->worst.axis = -1;
  const char *wrong = fmu_begin_early(c);
  if (!wrong && c->v.begun) lts_soil_newest(c->model.soil[tool], result);
  return wrong;
}

const char *fmu_get_integer(fmu_core *c, unsigned vr, int *value) {
  lts_soil_result result;
  if (vr >= FMU_TOOLS) return "no integer variable of this value reference";
  const char *wrong = newest(c, (int)vr, &result);
  *value = result.worst.status & LTS_NON_FINITE ? -1 : result.worst.axis + 1;
  return wrong;
}

const char *fmu_get_boolean(fmu_core *c, unsigned vr, int *value) {
  lts_soil_result result;
  if (vr >= FMU_TOOLS * N_BOOLEAN) return "no Boolean variable of this value reference";
  const int tool = (int)vr / N_BOOLEAN;
  const char *wrong = newest(c, tool, &result);
  const int told = c->v.own.told[tool];
  const int values[N_BOOLEAN] = {!told, !result.now.status, (told & LTS_EXTRAPOLATING) != 0,
                                 (told & LTS_NON_FINITE) != 0};
  *value = values[vr % N_BOOLEAN];
  return wrong;
}

const char *fmu_get_string(fmu_core *c, unsigned vr, const char **value) {
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

static size_t heights_size(const fmu_core *c) {
  return (size_t)c->model.ground.n[0] * (size_t)c->model.ground.n[1] * sizeof(double);
}

size_t fmu_state_size(const fmu_core *c) {
  size_t size = sizeof c->v;
  if (!c->v.begun) return size;
  for (int k = 0; k < FMU_TOOLS; ++k) size += sizeof size + lts_soil_state_size(c->model.soil[k]);
  return size + heights_size(c);
}

const char *fmu_write_state(fmu_core *c, void *bytes) {
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

const char *fmu_read_state(fmu_core *c, const void *bytes, size_t size) {
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
