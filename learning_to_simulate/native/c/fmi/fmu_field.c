/* The model of an FMU: a swept field. A communication step is a step of the model, however long. */
#include <string.h>

#include "fmu_core.h"

void fmu_soil_defaults(double *real) {
  const lts_field_description model = fmu_described();
  lts_pose pose;
  memcpy(real + VR_POSITION, model.start, sizeof model.start);
  real[VR_ROTATION] = 1.0;
  real[VR_FRAME_TIME] = model.dt;
  real[VR_CONTEXT] = model.blade_width;
  if (lts_field_start_pose(&FMU_MODEL, 0, &pose) < 0) return;
  memcpy(real + VR_ROTATION, pose.rotation, sizeof pose.rotation);
  lts_field_start_context(&FMU_MODEL, 0, real + VR_CONTEXT);
}

static void copy(const lts_field_result *from, fmu_answer *to) {
  memcpy(to->force, from->force, sizeof to->force);
  memcpy(to->torque, from->torque, sizeof to->torque);
  memcpy(to->point, from->point, sizeof to->point);
  to->bound = from->force_bound;
  to->frame = from->frame;
}

/* A wheel stands where the recorded one did, in its own print: its place is an output. */
int fmu_soil_start(fmu_core *c, fmu_answer *answer) {
  const lts_pose pose = fmu_pose(c);
  const lts_twist twist = fmu_twist(c);
  const double *context = c->v.real + VR_CONTEXT;
  lts_field_result result;
  int status = LTS_ERROR_VALUE;
  if (fmu_described().tool == LTS_FIELD_WHEEL) {
    status = lts_field_start_wheel(c->soil, c->v.start, NULL, &twist, NULL, context);
  } else if (context[0] > 0.0) {
    status = lts_field_start(c->soil, &pose, &twist, NULL, context[0]);
  }
  if (status < 0) return status;
  lts_field_newest(c->soil, &result);
  copy(&result, answer);
  return status;
}

int fmu_soil_step(fmu_core *c, double h, fmu_answer *answer) {
  const lts_pose pose = fmu_pose(c);
  const lts_twist twist = fmu_twist(c);
  lts_field_result result;
  int status = LTS_OK;
  if (FMU_LOAD >= 0) status = lts_field_set_context(c->soil, c->v.real + VR_CONTEXT);
  if (status >= 0) status = lts_field_advance(c->soil, h, &pose, &twist, &result);
  if (status >= 0) copy(&result, answer);
  return status;
}
