/* Tables of inputs that come with a model, see `soil_field/inputs.py`. */
#ifndef LTS_TABLE_H
#define LTS_TABLE_H

#include <stdint.h>

#define LTS_STACK 8 /* values that an operand needs at once, at most */

/* First what puts a value on the stack: a scalar of the frame, a number, u, y or z of a particle, a channel at
 * that u or at an offset; then what takes two; then what takes one. */
enum {
  LTS_OP_SCALAR = 0, LTS_OP_NUMBER = 1, LTS_OP_REST = 2, LTS_OP_HERE = 3, LTS_OP_AT = 4,
  LTS_OP_ADD = 5, LTS_OP_SUB = 6, LTS_OP_ABS = 7, LTS_OP_RELU = 8, LTS_OP_SQRT = 9
};
enum {
  LTS_SQUASH_PLAIN = 0, LTS_SQUASH_TANH = 1, LTS_SQUASH_RELU = 2, LTS_SQUASH_RELU2 = 3, LTS_SQUASH_BELL = 4,
  LTS_SQUASH_FADE = 5
};
typedef struct {
  int32_t code, index;
  float value; /* a number, or an offset, m */
} lts_op;
typedef struct {
  int32_t first, count, squash; /* operations of the operand */
  float shift, scale;
} lts_row;
typedef struct {
  int32_t n_row, unused;
  const lts_row *rows;
  const lts_op *ops;
} lts_table;

#endif
