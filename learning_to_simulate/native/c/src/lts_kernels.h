/* The arithmetic that is worth vectorising, once for each kind of machine. */
#ifndef LTS_KERNELS_H
#define LTS_KERNELS_H

#include "lts_model.h"

/* What a dense layer does with its sums s = x w + b. */
typedef enum {
  LTS_RELU,   /* y = max(s, 0) */
  LTS_NORMED, /* y = f s + o; no factor counts as 1, no offset as 0 */
  LTS_SQUARES, /* y[row] = |s|^2 */
  LTS_SILU    /* y = s / (1 + exp(-s)) */
} lts_form;

typedef struct {
  /* x [rows, row stride ldx], y [rows, row stride ldy]; y has whole panels of columns. factor [rows],
   * offset [columns]. */
  void (*dense)(const lts_dense *layer, const float *x, int ldx, int rows, float *y, int ldy,
                lts_form form, const float *factor, const float *offset);
  /* y = max(a + b + c, 0), each [n], n a multiple of a panel; b and c may be null. */
  void (*sum_relu)(const float *a, const float *b, const float *c, int n, float *y);
  /* y = tanh(x), [n], n a multiple of a panel; both may be the same. Within 4e-7. */
  void (*tanh_of)(const float *x, int n, float *y);
  /* y += weight x, [n]. */
  void (*accumulate)(float weight, const float *x, int n, float *y);
  /* Particles [first, last) of offsets [r][3], into out [last - first][3]; first is a multiple of 8. */
  void (*decode)(const lts_model *model, const float *offsets, int first, int last, float *out);
} lts_kernels;

/* The kernels of a kind, or null where this machine lacks them. LTS_BEST: its fastest. */
const lts_kernels *lts_find_kernels(int kind, int *found);

#endif
