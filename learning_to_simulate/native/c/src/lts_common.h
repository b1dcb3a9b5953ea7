/* What both kinds of models need: poses, height maps' cells, and the frame of saved bytes. */
#ifndef LTS_COMMON_H
#define LTS_COMMON_H

#include "lts.h"

#define LTS_ALIGNMENT 64
#define LTS_HEADER_SIZE 96 /* bytes before a saved state */

size_t lts_aligned(size_t n, size_t to);
int lts_all_finite(const double *values, size_t n);

void lts_rotate(const double q[4], const double v[3], double out[3]);
/* 0 where `q` stands for no rotation: not finite, or hardly longer than zero. */
int lts_unit_quaternion(const double q[4], double out[4]);
/* 0 where a pose or twist is not finite or has no rotation; `out` has a unit quaternion. */
int lts_usable_pose(const lts_pose *pose, lts_pose *out);
int lts_usable_twist(const lts_twist *twist);
void lts_moved_pose(const lts_pose *pose, const lts_twist *twist, double seconds, lts_pose *out);

/* Error of a grid that has no cells, or too many. */
int lts_check_grid(const lts_grid *grid);
/* Empties a height map; raises its cells to n points [n][3]. */
void lts_clear_heights(const lts_grid *grid, float *out);
void lts_raise_heights(const lts_grid *grid, int up, const float *points, int n, float *out);

/* Header of saved bytes: magic, ABI, digest, size and checksum. */
void lts_write_header(uint32_t magic, const char *digest, const void *state, size_t size, void *out);
/* Whether `header` is that of such a state; `size` gets its size without a look at the state. */
int lts_read_header(uint32_t magic, const char *digest, const void *header, size_t *size);
int lts_is_whole(const void *header, const void *state, size_t size);

#endif
