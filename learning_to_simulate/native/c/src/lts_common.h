/* What both kinds of models need: poses, reasons, and the frame of saved bytes. */
#ifndef LTS_COMMON_H
#define LTS_COMMON_H

#include "lts.h"

#define LTS_ALIGNMENT 64
#define LTS_MAGIC 0x4c545331u /* the first word of an instance, and of saved bytes */
#define LTS_HEADER_SIZE 96 /* bytes before a saved state */
#define LTS_LONGEST_NAME 64
#define LTS_PI 3.14159265358979323846

/* Returns the error of a call, where there is one. */
#define LTS_TRY(call)             \
  do {                            \
    const int lts_code = (call);  \
    if (lts_code < 0) return lts_code; \
  } while (0)

/* In a function that counts the bytes `at` of arrays, or (base not null) takes them from there: the next array. */
#define LTS_TAKE(array, type, count, alignment)              \
  do {                                                       \
    if (base) (array) = (type *)(void *)(base + at);         \
    at += lts_aligned((count) * sizeof(type), (alignment));  \
  } while (0)

/* The first aligned address of memory, whose next n bytes are set to 0. */
void *lts_cleared(void *memory, size_t n);

/* Whether what begins with its magic is an instance. */
int lts_check(const void *instance);

size_t lts_aligned(size_t n, size_t to);
int lts_all_finite(const double *values, size_t n);
/* Length of a vector [n]. */
double lts_length(const double *values, int n);

/* Mean of n points [n][3]. */
void lts_centroid(const double *points, int n, double out[3]);
void lts_rotate(const double q[4], const double v[3], double out[3]);
/* 0 where a pose or twist is not finite or has no rotation; `out` has a unit quaternion. */
int lts_usable_pose(const lts_pose *pose, lts_pose *out);
int lts_usable_twist(const lts_twist *twist);
void lts_moved_pose(const lts_pose *pose, const lts_twist *twist, double seconds, lts_pose *out);

/* Of a frame that is like those of training. */
extern const lts_judgement lts_well;

/* Writes why a frame is judged as it is; `measure` is what left its range. */
void lts_say(const lts_judgement *found, const char *measure, char *text, size_t size);
/* Copies name `index` of names that are separated by commas. */
void lts_name_of(const char *names, int index, char *name, size_t size);

/* Saved bytes: a header with magic, ABI, digest, size and checksum, and behind it the state of n bytes,
 * of which `size` bytes of room are given. Reading says whether all of it is as it was written. */
int lts_write_state(const char *digest, const void *state, size_t n, void *bytes, size_t size);
int lts_check_state(const char *digest, const void *bytes, size_t size, size_t n);

#endif
