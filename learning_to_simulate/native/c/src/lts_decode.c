/* From modes to particles and heights. */
#include <math.h>

#include "lts_internal.h"

#define CHUNK 64 /* particles at once; a multiple of every vector */
#define LARGEST_GRID 65536

int lts_modes(const lts_instance *soil, double *out) {
  LTS_TRY(lts_check_started(soil));
  if (!out) return LTS_ERROR_NULL;
  const int first = 3 * soil->model->n_rigid;
  for (int i = 0; i < 3 * soil->model->n_modes; ++i) {
    out[i] = soil->state.offset[first + i] + soil->model->origin[first + i];
  }
  return LTS_OK;
}

int lts_points(const lts_instance *soil, double *out) {
  LTS_TRY(lts_check_started(soil));
  if (!out && soil->model->n_rigid) return LTS_ERROR_NULL;
  for (int node = 0; node < soil->model->n_rigid; ++node) {
    float offset[3];
    lts_node_offset(soil, node, offset);
    for (int axis = 0; axis < 3; ++axis) {
      out[3 * node + axis] = offset[axis] + soil->model->origin[3 * node + axis];
    }
  }
  return LTS_OK;
}

static const float *mode_offsets(const lts_instance *soil) {
  return soil->state.offset + 3 * soil->model->n_rigid;
}

int lts_particles(const lts_instance *soil, float *out, size_t count) {
  LTS_TRY(lts_check_started(soil));
  if (!out) return LTS_ERROR_NULL;
  const int n = soil->model->n_soil;
  if (!n) return LTS_ERROR_CALL;
  if (count != (size_t)n) return LTS_ERROR_VALUE;
  soil->run->decode(soil->model, mode_offsets(soil), 0, n, out);
  return LTS_OK;
}

/* Whether a grid has cells, and not too many. */
static int is_usable(const lts_grid *grid) {
  for (int i = 0; i < 2; ++i) {
    if (grid->n[i] < 1 || grid->n[i] > LARGEST_GRID || !isfinite(grid->origin[i])) return 0;
  }
  return grid->cell > 0.0 && grid->cell <= 1e6;
}

int lts_height_map(const lts_instance *soil, const lts_grid *grid, float *out) {
  LTS_TRY(lts_check_started(soil));
  if (!grid || !out) return LTS_ERROR_NULL;
  const int n = soil->model->n_soil, up = soil->model->up_axis;
  if (!n) return LTS_ERROR_CALL;
  if (!is_usable(grid)) return LTS_ERROR_VALUE;
  for (size_t i = 0; i < (size_t)grid->n[0] * (size_t)grid->n[1]; ++i) out[i] = NAN;
  for (int done = 0; done < n; done += CHUNK) {
    float points[3 * CHUNK];
    const int last = done + CHUNK < n ? done + CHUNK : n;
    soil->run->decode(soil->model, mode_offsets(soil), done, last, points);
    for (const float *at = points; at < points + 3 * (last - done); at += 3) {
      const double u = (at[up == 0 ? 1 : 0] - grid->origin[0]) / grid->cell;
      const double v = (at[up == 2 ? 1 : 2] - grid->origin[1]) / grid->cell;
      if (!(u >= 0.0 && u < grid->n[0] && v >= 0.0 && v < grid->n[1])) continue;
      float *cell = out + (size_t)u * (size_t)grid->n[1] + (size_t)v;
      if (!(*cell >= at[up])) *cell = at[up];
    }
  }
  return LTS_OK;
}
