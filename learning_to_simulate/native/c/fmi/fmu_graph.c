/* The model of an FMU: a graph, or a network on the whole state. */
#include "fmu_core.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

const char *fmu_make(fmu_core *c) {
  const size_t size = lts_size(&FMU_MODEL);
  c->model.memory = c->allocate(1, size);
  if (!c->model.memory) return "out of memory";
  const int code = lts_init(&FMU_MODEL, c->model.memory, size, LTS_BEST, &c->model.soil);
  return code < 0 ? lts_error_text(code) : NULL;
}

void fmu_free(fmu_core *c) {
  if (c->model.memory) c->release(c->model.memory);
}

static lts_description described(void) {
  lts_description model;
  lts_describe(&FMU_MODEL, &model);
  return model;
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

static void take(fmu_core *c, const lts_result *answer) {
  double *real = c->v.real;
  const int up = described().up_axis;
  memcpy(real + VR_POINT, answer->point, sizeof answer->point);
  memcpy(real + VR_FORCE, answer->force, sizeof answer->force);
  real[VR_SINKAGE] = c->v.own.first_height - answer->point[up];
  real[VR_DRAWBAR] = drawbar_of(real + VR_LINEAR, answer->force, up);
}

/* Says once when a kind of status begins, and why where it is what the frame is judged by. */
static void tell(fmu_core *c, int status, int frame) {
  static const char *const texts[FMU_STATUS_BITS] = {
      "the context lies outside the training runs",
      "the start lies outside the training runs",
      "the pose lies outside the training runs",
      "the speed lies outside the training runs",
      "the soil left the bounds of the training runs",
      "a position or force is not finite"};
  char text[320], why[200] = "";
  lts_judgement judged = {0};
  if (status) lts_judge(c->model.soil, &judged);
  if (status) lts_reason(c->model.soil, why, sizeof why);
  for (int i = 0; i < FMU_STATUS_BITS; ++i) {
    if (!((status & ~c->v.own.told) >> i & 1)) continue;
    snprintf(text, sizeof text, "frame %d: %s", frame, texts[i]);
    const size_t n = strlen(text);
    if (judged.status >> i & 1) snprintf(text + n, sizeof text - n, ": %s", why);
    c->warn(c, text);
  }
  c->v.own.told |= status;
}

/* Goes on by h s from the current values. Frames stay whole: see lts_advance. */
static int go_on(fmu_core *c, double h, lts_result *answer) {
  const lts_pose pose = fmu_pose(c->v.real);
  const lts_twist twist = fmu_twist(c->v.real);
  return lts_advance(c->model.soil, h, FMU_GIVEN ? &pose : NULL, FMU_GIVEN ? &twist : NULL, answer);
}

const char *fmu_begin(fmu_core *c) {
  if (c->v.begun) return NULL;
  const lts_pose pose = fmu_pose(c->v.real);
  const lts_twist twist = fmu_twist(c->v.real);
  lts_result answer;
  int status = lts_start(c->model.soil, c->v.own.start, &pose, &twist, c->v.real + VR_CONTEXT);
  if (status >= 0) status = go_on(c, 0.0, &answer);
  if (status < 0) return lts_error_text(status);
  c->v.own.first_height = answer.point[described().up_axis];
  c->v.own.told = 0;
  take(c, &answer);
  tell(c, status, 0);
  c->v.begun = 1;
  return NULL;
}

void fmu_clear(fmu_core *c) { c->v.own.start = -1; }

void fmu_show(fmu_core *c, unsigned vr) { (void)c, (void)vr; }

const char *fmu_go(fmu_core *c, double h) {
  lts_result answer;
  const int status = go_on(c, h, &answer);
  if (status < 0) return lts_error_text(status);
  take(c, &answer);
  tell(c, status, answer.frame);
  return status & LTS_NON_FINITE ? "the soil has left all numbers" : NULL;
}

const char *fmu_get_integer(fmu_core *c, unsigned vr, int *value) {
  if (vr) return "no integer variable of this value reference";
  *value = c->v.own.start;
  return NULL;
}

const char *fmu_set_integer(fmu_core *c, unsigned vr, int start) {
  if (vr) return "no integer variable of this value reference";
  if (c->v.now >= FMU_STEPPING) return FMU_TOO_LATE;
  if (start < -1 || start >= described().n_start) return "the model has no such start";
  c->v.own.start = start;
  c->v.begun = 0;
  return NULL;
}

const char *fmu_get_boolean(fmu_core *c, unsigned which, int *value) {
  static const int bits[N_BOOLEAN] = {0, LTS_EXTRAPOLATING, LTS_LEFT_BOUNDS, LTS_NON_FINITE};
  if (which >= N_BOOLEAN) return "no Boolean variable of this value reference";
  const char *wrong = fmu_begin_early(c);
  *value = which ? (c->v.own.told & bits[which]) != 0 : !c->v.own.told;
  return wrong;
}

const char *fmu_get_string(fmu_core *c, unsigned vr, const char **value) {
  (void)c;
  if (vr) return "no string variable of this value reference";
  *value = described().digest;
  return NULL;
}

const char *fmu_derivative(fmu_core *c, const unsigned *unknown, size_t n_unknown, const unsigned *known,
                           size_t n_known, const double *d_known, double *d_unknown) {
  (void)c, (void)unknown, (void)known, (void)n_known, (void)d_known, (void)d_unknown;
  return n_unknown ? "a model in the subspace has no directional derivatives" : NULL;
}

size_t fmu_state_size(const fmu_core *c) {
  return sizeof c->v + lts_state_size(&FMU_MODEL);
}

const char *fmu_write_state(fmu_core *c, void *bytes) {
  memcpy(bytes, &c->v, sizeof c->v);
  const size_t size = fmu_state_size(c) - sizeof c->v;
  const int code = lts_save(c->model.soil, (char *)bytes + sizeof c->v, size);
  return code < 0 ? lts_error_text(code) : NULL;
}

const char *fmu_read_state(fmu_core *c, const void *bytes, size_t size) {
  if (size <= sizeof c->v) return "the bytes are no state of this FMU";
  const int code = lts_load(c->model.soil, (const char *)bytes + sizeof c->v, size - sizeof c->v);
  if (code < 0) return lts_error_text(code);
  memcpy(&c->v, bytes, sizeof c->v);
  if (c->v.own.start < -1) c->v.own.start = -1; /* of forged bytes; the model refuses what is too large */
  return NULL;
}
