/* The life of an FMU. Inputs are the pose and the velocity of each body at the beginning of a communication step. A
 * model wants the coming pose: the velocity leads to it. */
#include "fmu_core.h"

#include <math.h>
#include <string.h>

const char *fmu_initialise(fmu_core *c) {
  if (c->v.now != FMU_CREATED) return "the initialisation is entered twice";
  c->v.now = FMU_INITIALISING;
  return NULL;
}

const char *fmu_start_stepping(fmu_core *c) {
  if (c->v.now != FMU_INITIALISING) return "the initialisation is left out of turn";
  const char *wrong = fmu_begin(c);
  if (!wrong) c->v.now = FMU_STEPPING;
  return wrong;
}

const char *fmu_step(fmu_core *c, double time, double h) {
  if (c->v.now != FMU_STEPPING) return "a step before the end of the initialisation";
  if (!(h > 0.0) || !isfinite(time)) return "the step has no positive length";
  const char *wrong = fmu_go(c, h);
  if (!wrong) c->v.time = time + h;
  return wrong;
}

const char *fmu_check_set(const fmu_core *c, int is_parameter, double value) {
  if (is_parameter && c->v.now >= FMU_STEPPING) return "a fixed parameter is set after the initialisation";
  return isfinite(value) ? NULL : "an input or parameter is not finite";
}

/* ---- variables ---- */

static const double first_values[N_REAL] = FMU_FIRST;
static const unsigned char kinds[N_REAL] = FMU_KINDS;

void fmu_defaults(fmu_core *c) {
  memset(&c->v, 0, sizeof c->v);
  memcpy(c->v.real, first_values, sizeof first_values);
  fmu_clear(c);
}

const char *fmu_get_reals(fmu_core *c, const unsigned *vr, size_t n, double *value) {
  for (size_t i = 0; i < n; ++i) {
    if (vr[i] >= N_REAL) return "no real variable of this value reference";
    if (kinds[vr[i]] == FMU_OUTPUT) {
      const char *wrong = c->v.now == FMU_INITIALISING ? fmu_begin(c) : NULL;
      if (wrong) return wrong;
      if (c->v.begun) fmu_show(c, vr[i]);
    }
    value[i] = c->v.real[vr[i]];
  }
  return NULL;
}

const char *fmu_set_reals(fmu_core *c, const unsigned *vr, size_t n, const double *value) {
  for (size_t i = 0; i < n; ++i) {
    const int kind = vr[i] < N_REAL ? kinds[vr[i]] : FMU_NONE;
    if (kind != FMU_INPUT && kind != FMU_PARAMETER) return "this real variable cannot be set";
    const char *wrong = fmu_check_set(c, kind == FMU_PARAMETER, value[i]);
    if (wrong) return wrong;
  }
  for (size_t i = 0; i < n; ++i) c->v.real[vr[i]] = value[i];
  if (c->v.now < FMU_STEPPING) c->v.begun = 0;
  return NULL;
}

lts_pose fmu_pose(const double *inputs) {
  lts_pose pose;
  memcpy(pose.position, inputs + VR_POSITION, sizeof pose.position);
  memcpy(pose.rotation, inputs + VR_ROTATION, sizeof pose.rotation);
  return pose;
}

lts_twist fmu_twist(const double *inputs) {
  lts_twist twist;
  memcpy(twist.linear, inputs + VR_LINEAR, sizeof twist.linear);
  memcpy(twist.angular, inputs + VR_ANGULAR, sizeof twist.angular);
  return twist;
}
