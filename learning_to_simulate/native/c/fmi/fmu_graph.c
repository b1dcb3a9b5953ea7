/* The model of an FMU: a graph or a network on the whole state. Frames stay whole: see lts_advance. */
#include <string.h>

#include "fmu_core.h"

static lts_description described(void) {
  lts_description model;
  lts_describe(&FMU_MODEL, &model);
  return model;
}

size_t fmu_soil_size(void) { return lts_size(&FMU_MODEL); }

const char *fmu_soil_make(void *memory, size_t size, void **soil) {
  lts_instance *made = NULL;
  const int code = lts_init(&FMU_MODEL, memory, size, LTS_BEST, &made);
  *soil = made;
  return code < 0 ? lts_error_text(code) : NULL;
}

void fmu_soil_defaults(double *real) {
  lts_pose pose;
  lts_start_pose(&FMU_MODEL, 0, &pose);
  memcpy(real + VR_POSITION, pose.position, sizeof pose.position);
  memcpy(real + VR_ROTATION, pose.rotation, sizeof pose.rotation);
  real[VR_FRAME_TIME] = described().dt;
  lts_start_context(&FMU_MODEL, 0, real + VR_CONTEXT);
}

int fmu_soil_starts(void) { return described().n_start; }
int fmu_soil_up(void) { return described().up_axis; }
const char *fmu_soil_digest(void) { return described().digest; }

static void copy(const lts_result *from, int status, fmu_answer *to) {
  memcpy(to->force, from->force, sizeof to->force);
  memcpy(to->point, from->point, sizeof to->point);
  to->frame = from->frame;
  to->status = status;
}

int fmu_soil_start(fmu_core *c, fmu_answer *answer) {
  const lts_pose pose = fmu_pose(c);
  const lts_twist twist = fmu_twist(c);
  lts_instance *soil = (lts_instance *)c->soil;
  double points[3 * FMU_RIGID + 3];
  const int status = lts_start(soil, c->v.start, &pose, &twist, c->v.real + VR_CONTEXT);
  if (status < 0) return status;
  lts_points(soil, points);
  for (int i = 0; i < 3 * FMU_RIGID; ++i) {
    answer->point[i % 3] += points[i] / (FMU_RIGID + !FMU_RIGID);
  }
  return status;
}

int fmu_soil_step(fmu_core *c, double h, fmu_answer *answer) {
  const lts_pose pose = fmu_pose(c);
  const lts_twist twist = fmu_twist(c);
  lts_result result;
  const int status = lts_advance((lts_instance *)c->soil, h, FMU_GIVEN ? &pose : NULL,
                                 FMU_GIVEN ? &twist : NULL, &result);
  if (status >= 0) copy(&result, status, answer);
  return status;
}

size_t fmu_soil_state_size(const void *soil) {
  (void)soil;
  return lts_state_size(&FMU_MODEL);
}
int fmu_soil_save(const void *soil, void *bytes, size_t size) {
  return lts_save((const lts_instance *)soil, bytes, size);
}
int fmu_soil_load(void *soil, const void *bytes, size_t size) {
  return lts_load((lts_instance *)soil, bytes, size);
}
