/* The model of an FMU: a graph or a network on the whole state. Frames stay whole: see lts_advance. */
#include <string.h>

#include "fmu_core.h"

void fmu_soil_defaults(double *real) {
  lts_pose pose;
  lts_start_pose(&FMU_MODEL, 0, &pose);
  memcpy(real + VR_POSITION, pose.position, sizeof pose.position);
  memcpy(real + VR_ROTATION, pose.rotation, sizeof pose.rotation);
  real[VR_FRAME_TIME] = fmu_described().dt;
  lts_start_context(&FMU_MODEL, 0, real + VR_CONTEXT);
}

/* A start answers as a step of no time. */
int fmu_soil_start(fmu_core *c, fmu_answer *answer) {
  const lts_pose pose = fmu_pose(c);
  const lts_twist twist = fmu_twist(c);
  const int status = lts_start(c->soil, c->v.start, &pose, &twist, c->v.real + VR_CONTEXT);
  return status < 0 ? status : fmu_soil_step(c, 0.0, answer);
}

int fmu_soil_step(fmu_core *c, double h, fmu_answer *answer) {
  const lts_pose pose = fmu_pose(c);
  const lts_twist twist = fmu_twist(c);
  lts_result result;
  const int status =
      lts_advance(c->soil, h, FMU_GIVEN ? &pose : NULL, FMU_GIVEN ? &twist : NULL, &result);
  if (status < 0) return status;
  memcpy(answer->force, result.force, sizeof answer->force);
  memcpy(answer->point, result.point, sizeof answer->point);
  answer->frame = result.frame;
  return status;
}
