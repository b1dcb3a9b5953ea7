/* What the tool feels: the networks of the load, their mean and their spread. */
#include <math.h>
#include <string.h>

#include "lts_field_internal.h"

double lts_field_find_load(lts_field *soil, lts_field_result *result) {
  const lts_field_model *m = soil->model;
  const lts_kernels *run = soil->run;
  const int latent = LTS_PADDED(m->load_latent), n = soil->of_force;
  double mean[LTS_MOST_LOADS] = {0.0}, square[LTS_MOST_LOADS] = {0.0};
  float share[3];
  if (soil->tool->load_share(soil, share)) {
    lts_dense first = m->load_first;
    first.columns = n * latent;
    lts_field_read(soil, &m->force_inputs, soil->seen);
    run->dense(&first, soil->seen, m->n_force, 1, soil->a, first.columns, LTS_SILU, NULL, NULL);
    for (int member = 0; member < n; ++member) {
      float *x = soil->a + member * latent, *y = soil->b + member * latent;
      for (int k = 0; k < m->n_load_hidden; ++k) {
        const lts_dense *layer = &m->load_hidden[member * m->n_load_hidden + k];
        run->dense(layer, x, latent, 1, y, latent, LTS_SILU, NULL, NULL);
        float *other = x;
        x = y;
        y = other;
      }
      run->dense(&m->load_last[member], x, latent, 1, soil->out, LTS_PANEL, LTS_NORMED, NULL, NULL);
      double load[LTS_MOST_LOADS];
      soil->tool->load_of(m, soil->out, share, load);
      for (int k = 0; k < LTS_MOST_LOADS; ++k) {
        const double away = load[k] - mean[k]; /* Welford's mean and spread */
        mean[k] += away / (member + 1);
        square[k] += away * (load[k] - mean[k]);
      }
    }
  }
  const int across = 3 - m->axis - m->up;
  memset(result->force, 0, sizeof result->force);
  memset(result->torque, 0, sizeof result->torque);
  result->force[m->axis] = m->sign * mean[0];
  result->force[m->up] = mean[1];
  result->torque[across] = m->turn * mean[2];
  result->force_bound = 0.0;
  if (m->bound) {
    const double spread = sqrt(0.5 * (square[0] + square[1]) / n);
    const double size = sqrt(0.5 * (mean[0] * mean[0] + mean[1] * mean[1]));
    result->force_bound = m->bound[0] + m->bound[1] * spread + m->bound[2] * size;
  }
  return mean[3];
}
