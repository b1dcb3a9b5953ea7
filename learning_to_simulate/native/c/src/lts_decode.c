/* From modes to particles and heights. */
#include "lts_internal.h"

#define CHUNK 64 /* particles at once; a multiple of every vector */

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

int lts_height_map(const lts_instance *soil, const lts_grid *grid, float *out) {
  LTS_TRY(lts_check_started(soil));
  if (!grid || !out) return LTS_ERROR_NULL;
  const int n = soil->model->n_soil, up = soil->model->up_axis;
  if (!n) return LTS_ERROR_CALL;
  LTS_TRY(lts_check_grid(grid));
  lts_clear_heights(grid, out);
  for (int done = 0; done < n; done += CHUNK) {
    float points[3 * CHUNK];
    const int last = done + CHUNK < n ? done + CHUNK : n;
    soil->run->decode(soil->model, mode_offsets(soil), done, last, points);
    lts_raise_heights(grid, up, points, last - done, out);
  }
  return LTS_OK;
}
