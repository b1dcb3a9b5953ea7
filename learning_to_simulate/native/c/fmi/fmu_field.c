/* The model of an FMU: a swept field. A communication step is a step of the model, however long. */
#include <string.h>

#include "fmu_core.h"
#include "lts_field.h"

static lts_field_description described(void) {
  lts_field_description model;
  lts_field_describe(&FMU_MODEL, &model);
  return model;
}

size_t fmu_soil_size(void) { return lts_field_size(&FMU_MODEL); }

const char *fmu_soil_make(void *memory, size_t size, void **soil) {
  lts_field *made = NULL;
  const int code = lts_field_init(&FMU_MODEL, memory, size, LTS_BEST, &made);
  *soil = made;
  return code < 0 ? lts_error_text(code) : NULL;
}

void fmu_soil_defaults(double *real) {
  const lts_field_description model = described();
  memcpy(real + VR_POSITION, model.start, sizeof model.start);
  real[VR_ROTATION] = 1.0;
  real[VR_FRAME_TIME] = model.dt;
  real[VR_CONTEXT] = model.blade_width;
  lts_pose pose;
  if (lts_field_start_pose(&FMU_MODEL, 0, &pose) < 0) return;
  memcpy(real + VR_ROTATION, pose.rotation, sizeof pose.rotation);
  lts_field_start_context(&FMU_MODEL, 0, real + VR_CONTEXT);
}

int fmu_soil_starts(void) {
  const int n = described().n_start;
  return n ? n : 1;
}
int fmu_soil_up(void) { return described().up_axis; }
const char *fmu_soil_digest(void) { return described().digest; }

static int start_blade(fmu_core *c, const lts_twist *twist) {
  const lts_pose pose = fmu_pose(c);
  const double width = c->v.real[VR_CONTEXT];
  if (!(width > 0.0)) return LTS_ERROR_VALUE;
  return lts_field_start((lts_field *)c->soil, &pose, twist, NULL, width);
}

/* A wheel stands where the recorded one did, in its own print: its place is an output. */
static int start_wheel(fmu_core *c, const lts_twist *twist) {
  return lts_field_start_wheel((lts_field *)c->soil, c->v.start, NULL, twist, NULL,
                               c->v.real + VR_CONTEXT);
}

int fmu_soil_start(fmu_core *c, fmu_answer *answer) {
  const lts_twist twist = fmu_twist(c);
  lts_field_result result;
  const int status = described().tool == LTS_FIELD_WHEEL ? start_wheel(c, &twist)
                                                         : start_blade(c, &twist);
  if (status < 0) return status;
  lts_field_newest((const lts_field *)c->soil, &result);
  memcpy(answer->point, result.point, sizeof answer->point);
  return status;
}

int fmu_soil_step(fmu_core *c, double h, fmu_answer *answer) {
  const lts_pose pose = fmu_pose(c);
  const lts_twist twist = fmu_twist(c);
  lts_field_result result;
  if (described().tool == LTS_FIELD_WHEEL) {
    const int bad = lts_field_set_context((lts_field *)c->soil, c->v.real + VR_CONTEXT);
    if (bad) return bad;
  }
  const int status = lts_field_advance((lts_field *)c->soil, h, &pose, &twist, &result);
  if (status < 0) return status;
  memcpy(answer->force, result.force, sizeof answer->force);
  memcpy(answer->torque, result.torque, sizeof answer->torque);
  memcpy(answer->point, result.point, sizeof answer->point);
  answer->bound = result.force_bound;
  answer->frame = result.frame;
  return status;
}

size_t fmu_soil_state_size(const void *soil) {
  return lts_field_state_size((const lts_field *)soil);
}
int fmu_soil_save(const void *soil, void *bytes, size_t size) {
  return lts_field_save((const lts_field *)soil, bytes, size);
}
int fmu_soil_load(void *soil, const void *bytes, size_t size) {
  return lts_field_load((lts_field *)soil, bytes, size);
}
