/* CPU time of single calls, for the benchmark command; compiled beside the library. */
#define _POSIX_C_SOURCE 199309L
#include <time.h>

#include "lts.h"
#include "lts_field.h"

static double seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Plays a recorded path n times from the state `saved`: points [n_frame][R][3] or null. Writes, for
 * each call, the seconds of prepare, of frame after it, and of the decoding into particles [N][3] (null:
 * none) to `prepare`, `frame` and `decode` [n n_frame]. Returns 0, or the error that a call gave. */
LTS_API int lts_time_calls(lts_instance *soil, const void *saved, size_t size, const double *points,
                           int values_per_frame, int n_frame, int n, float *particles, size_t n_soil,
                           double *prepare, double *frame, double *decode) {
  size_t at = 0;
  for (int i = 0; i < n; ++i) {
    int error = lts_load(soil, saved, size);
    if (error < 0) return error;
    for (int k = 0; k < n_frame; ++k, ++at) {
      const double t0 = seconds();
      if ((error = lts_prepare(soil)) < 0) return error;
      const double t1 = seconds();
      const double *pose = points ? points + (size_t)k * (size_t)values_per_frame : NULL;
      if ((error = lts_frame(soil, pose, NULL)) < 0) return error;
      const double t2 = seconds();
      if (particles && (error = lts_particles(soil, particles, n_soil)) < 0) return error;
      const double t3 = seconds();
      prepare[at] = t1 - t0;
      frame[at] = t2 - t1;
      decode[at] = t3 - t2;
    }
  }
  return 0;
}

/* The same for a swept field on its path: poses [n_frame], `dt` seconds apart. */
LTS_API int lts_time_field(lts_field *soil, const void *saved, size_t size, const lts_pose *poses,
                           int n_frame, double dt, int n, float *particles, size_t n_soil,
                           double *frame, double *decode) {
  size_t at = 0;
  for (int i = 0; i < n; ++i) {
    int error = lts_field_load(soil, saved, size);
    if (error < 0) return error;
    for (int k = 0; k < n_frame; ++k, ++at) {
      const double t0 = seconds();
      if ((error = lts_field_frame(soil, poses + k, dt, NULL)) < 0) return error;
      const double t1 = seconds();
      if (particles && (error = lts_field_particles(soil, particles, n_soil)) < 0) return error;
      const double t2 = seconds();
      frame[at] = t1 - t0;
      decode[at] = t2 - t1;
    }
  }
  return 0;
}
