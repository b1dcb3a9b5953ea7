/* The life of an FMU. Inputs are the pose and the velocity of each body at the beginning of a communication step. A
 * model wants the coming pose: the velocity leads to it. */
#include "fmu_core.h"

#include <math.h>

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
