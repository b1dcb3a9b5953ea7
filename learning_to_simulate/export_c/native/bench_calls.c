/* Loops for the commands `benchmark` and `endurance`: CPU time of single calls, and runs of millions
 * of frames. Compiled beside the library. */
#define _POSIX_C_SOURCE 199309L
#include <math.h>
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

static void take(const double *values, int n, double *largest, int64_t *not_finite) {
  for (int i = 0; i < n; ++i) {
    if (!isfinite(values[i])) ++*not_finite;
    if (fabs(values[i]) > *largest) *largest = fabs(values[i]);
  }
}

/* Goes on for n frames along a path of n_frame, from frame `at` of it, that begins again where it ends:
 * from the state `saved` if there is one, else from where the soil then is. points [n_frame][R][3] or
 * null; `modes` has room for the modes. Raises `largest` [2] to the largest mode (m) and force (N),
 * counts values that are not finite and joins the status bits. Returns 0, or the error of a call. */
LTS_API int lts_run_on(lts_instance *soil, const void *saved, size_t size, const double *points,
                       int values_per_frame, int n_frame, int64_t at, int64_t n, double *modes,
                       int n_values, double *largest, int64_t *not_finite, int32_t *status) {
  for (int64_t i = at; i < at + n; ++i) {
    const int64_t k = i % n_frame;
    lts_result result;
    int code = saved && k == 0 ? lts_load(soil, saved, size) : 0;
    if (code >= 0) code = lts_frame(soil, points ? points + k * values_per_frame : NULL, &result);
    if (code < 0) return code;
    *status |= code;
    if ((code = lts_modes(soil, modes)) < 0) return code;
    take(modes, n_values, largest, not_finite);
    take(result.force, 3, largest + 1, not_finite);
  }
  return 0;
}

/* The same for a swept field, `dt` seconds a frame: `largest` torque (N m) and force (N). */
LTS_API int lts_run_field_on(lts_field *soil, const void *saved, size_t size, const lts_pose *poses,
                             int n_frame, double dt, int64_t at, int64_t n, double *largest,
                             int64_t *not_finite, int32_t *status) {
  for (int64_t i = at; i < at + n; ++i) {
    const int64_t k = i % n_frame;
    lts_field_result result;
    int code = saved && k == 0 ? lts_field_load(soil, saved, size) : 0;
    if (code >= 0) code = lts_field_frame(soil, poses + k, dt, &result);
    if (code < 0) return code;
    *status |= code;
    take(result.torque, 3, largest, not_finite);
    take(result.force, 3, largest + 1, not_finite);
  }
  return 0;
}
