/* The model behind a page without a server: what JavaScript calls, over memory of its own.
 * Compiled with LTS_MODEL, the symbol of the model, and LTS_SOIL, its number of particles. */
#include "lts.h"

#define EXPORT(name) __attribute__((export_name(#name))) name

extern const lts_model LTS_MODEL;

static unsigned char memory[1 << 22];
static lts_instance *soil;
static lts_result result;
static double pose[7]; /* x y z, w x y z: JavaScript writes it */
static float particles[3 * LTS_SOIL];

double *EXPORT(page_pose)(void) { return pose; }
float *EXPORT(page_particles)(void) { return particles; }
double *EXPORT(page_force)(void) { return result.force; }
double *EXPORT(page_point)(void) { return result.point; }

/* Begins again; the status of the start, or an error of lts.h. */
int EXPORT(page_start)(void) {
  int status = soil ? 0 : lts_init(&LTS_MODEL, memory, sizeof memory, LTS_BEST, &soil);
  if (status < 0 || (status = lts_start(soil, 0, NULL, NULL, NULL)) < 0) return status;
  const int drawn = lts_particles(soil, particles, LTS_SOIL);
  return drawn < 0 ? drawn : status;
}

/* One frame to the pose; its status bits, or an error of lts.h, after which nothing has changed. */
int EXPORT(page_frame)(void) {
  lts_pose coming;
  for (int i = 0; i < 3; ++i) coming.position[i] = pose[i];
  for (int i = 0; i < 4; ++i) coming.rotation[i] = pose[3 + i];
  const int status = lts_frame_at(soil, &coming, &result);
  if (status >= 0) lts_particles(soil, particles, LTS_SOIL);
  return status;
}
