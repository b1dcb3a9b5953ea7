/* The placement of a predicted body. */
#include <math.h>

#include "lts_internal.h"

static void turn(double *x, double *y, double c, double s) {
  const double before = *x;
  *x = c * before - s * *y;
  *y = s * before + c * *y;
}

/* Eigenvector of the largest eigenvalue of a symmetric 4 x 4 matrix, by Jacobi rotations: they need no
 * start and no shift, and converge for equal eigenvalues too. */
static void largest_eigenvector(double a[4][4], double out[4]) {
  double v[4][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};
  for (int sweep = 0; sweep < 30; ++sweep) {
    double off = 0.0, size = 0.0;
    for (int p = 0; p < 4; ++p) {
      for (int q = 0; q < 4; ++q) *(p == q ? &size : &off) += a[p][q] * a[p][q];
    }
    if (!(off > 1e-32 * size)) break;
    for (int p = 0; p < 3; ++p) {
      for (int q = p + 1; q < 4; ++q) {
        if (a[p][q] == 0.0) continue;
        const double theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
        const double t = (theta < 0 ? -1.0 : 1.0) / (fabs(theta) + sqrt(theta * theta + 1.0));
        const double c = 1.0 / sqrt(t * t + 1.0), s = t * c;
        for (int k = 0; k < 4; ++k) turn(&a[k][p], &a[k][q], c, s);
        for (int k = 0; k < 4; ++k) turn(&a[p][k], &a[q][k], c, s);
        for (int k = 0; k < 4; ++k) turn(&v[k][p], &v[k][q], c, s);
      }
    }
  }
  int best = 0;
  for (int i = 1; i < 4; ++i) best = a[i][i] > a[best][best] ? i : best;
  for (int i = 0; i < 4; ++i) out[i] = v[i][best];
}

/* Nearest rigid placement of a body to predicted points (Usmani & Skonieczny 2023, Algorithm 3), in
 * Horn's quaternion form (J. Opt. Soc. Am. A 4, 1987). `shape` has its centroid at zero. */
void lts_place_rigid(int n, const double *shape, const double *predicted, double *placed) {
  double centroid[3], s[3][3] = {{0.0}}, q[4];
  lts_centroid(predicted, n, centroid);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) {
        s[j][k] += shape[3 * i + j] * (predicted[3 * i + k] - centroid[k]);
      }
    }
  }
  double form[4][4] = {
      {s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]},
      {s[1][2] - s[2][1], s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]},
      {s[2][0] - s[0][2], s[0][1] + s[1][0], s[1][1] - s[0][0] - s[2][2], s[1][2] + s[2][1]},
      {s[0][1] - s[1][0], s[2][0] + s[0][2], s[1][2] + s[2][1], s[2][2] - s[0][0] - s[1][1]},
  };
  largest_eigenvector(form, q);
  for (int i = 0; i < n; ++i) {
    double rotated[3];
    lts_rotate(q, shape + 3 * i, rotated);
    for (int j = 0; j < 3; ++j) placed[3 * i + j] = centroid[j] + rotated[j];
  }
}
