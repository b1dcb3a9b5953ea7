/* What both kinds of models need: poses, reasons, and the frame of saved bytes. */
#ifndef LTS_COMMON_H
#define LTS_COMMON_H

#include "lts.h"

#define LTS_ALIGNMENT 64
#define LTS_MAGIC 0x4c545331u /* the first word of an instance, and of saved bytes */
#define LTS_HEADER_SIZE 96 /* bytes before a saved state */
#define LTS_LONGEST_NAME 64

/* Returns the error of a call, where there is one. */
#define LTS_TRY(call)             \
  do {                            \
    const int lts_code = (call);  \
    if (lts_code < 0) return lts_code; \
  } while (0)

/* Whether what begins with its magic is an instance. */
int lts_check(const void *instance);

size_t lts_aligned(size_t n, size_t to);
int lts_all_finite(const double *values, size_t n);

/* Mean of n points [n][3]. */
void lts_centroid(const double *points, int n, double out[3]);
void lts_rotate(const double q[4], const double v[3], double out[3]);
/* 0 where a pose or twist is not finite or has no rotation; `out` has a unit quaternion. */
int lts_usable_pose(const lts_pose *pose, lts_pose *out);
int lts_usable_twist(const lts_twist *twist);
void lts_moved_pose(const lts_pose *pose, const lts_twist *twist, double seconds, lts_pose *out);

/* Writes why a frame is judged as it is; `measure` is what left its range. */
void lts_say(const lts_judgement *found, const char *measure, char *text, size_t size);
/* Copies name `index` of names that are separated by commas. */
void lts_name_of(const char *names, int index, char *name, size_t size);

/* Saved bytes: a header with magic, ABI, digest, size and checksum, and behind it the state of n bytes,
 * of which `size` bytes of room are given. Reading says whether all of it is as it was written. */
int lts_write_state(const char *digest, const void *state, size_t n, void *bytes, size_t size);
int lts_check_state(const char *digest, const void *bytes, size_t size, size_t n);

#endif
