/* Particles: which may have moved, where they are, none inside the tool. */
#include <math.h>
#include <string.h>

#include "lts_field_internal.h"

/* Particles at rest as the networks take them: once for each bed and first place. */
static void make_local(lts_field *soil) {
  const lts_field_model *m = soil->model;
  const lts_field_head *h = soil->head;
  if (soil->has_local && soil->local_is_of_bed == h->has_bed &&
      !memcmp(&soil->local_of, &h->ground, sizeof h->ground)) {
    return;
  }
  const float *rest = h->has_bed ? soil->bed : m->rest;
  for (int i = 0; i < m->n_soil; ++i) {
    double plane[3];
    lts_field_plane(m, rest + 3 * i, plane);
    soil->u[i] = (float)(plane[0] - h->ground.origin);
    soil->y[i] = (float)(plane[1] - h->ground.level);
    soil->z[i] = (float)plane[2];
    const float bin = (soil->u[i] - m->first_bin) / m->bin_width;
    const float low = floorf(fminf(fmaxf(bin, -(float)m->n_pad), (float)(m->n_bin - 1 + m->n_pad)));
    soil->low[i] = (int32_t)low;
    soil->share[i] = fminf(fmaxf(bin - low, 0.0f), 1.0f);
    const float half_width = (float)(0.5 * h->ground.width);
    const float beside = (half_width + m->beside - fabsf(soil->z[i])) / m->beside_ramp;
    soil->beside[i] = beside < 0.0f ? 0.0f : beside > 1.0f ? 1.0f : beside;
  }
  soil->local_of = h->ground;
  soil->local_is_of_bed = h->has_bed;
  soil->has_local = 1;
}

/* Numbers and gates of the particles that may have moved; how many they are. */
static int find_moving(lts_field *soil) {
  const lts_field_model *m = soil->model;
  const float *influence = soil->bins[LTS_INFLUENCE], *surface = soil->bins[LTS_SURFACE];
  const float *disturbed = soil->bins[LTS_DISTURBED];
  int n = 0;
  make_local(soil);
  soil->tool->see(soil);
  soil->tool->see_reach(soil);
  for (int i = 0; i < m->n_soil; ++i) {
    const int low = soil->low[i];
    const float s = soil->share[i], r = 1.0f - s;
    const float reach = r * influence[low] + s * influence[low + 1];
    if (!(reach * soil->beside[i] > 0.0f)) continue;
    const float depth = r * surface[low] + s * surface[low + 1] - soil->y[i];
    const float rim = r * disturbed[low] + s * disturbed[low + 1];
    const float below = (rim + m->below - depth) / m->below_ramp;
    if (!(below > 0.0f)) continue;
    soil->gate[n] = reach * (below < 1.0f ? below : 1.0f) * soil->beside[i];
    soil->moving[n++] = i;
  }
  return n;
}

/* Mean displacement [n][3] over members of at most LTS_FIELD_ROWS particles, without units. */
static void displacement(lts_field *soil, const int32_t *which, int n, float *mean) {
  const lts_field_model *m = soil->model;
  const lts_kernels *run = soil->run;
  const int ld = LTS_PADDED(m->n_seen), latent = LTS_PADDED(m->latent);
  lts_field_read_particles(soil, which, n, soil->seen, ld);
  for (int i = 0; i < 3 * n; ++i) mean[i] = 0.0f;
  for (int member = 0; member < soil->of_particles; ++member) {
    float *a = soil->a, *b = soil->b;
    lts_dense first = m->soil_first[member];
    first.b = soil->bias + member * latent;
    run->dense(&first, soil->seen, ld, n, a, latent, LTS_SILU, NULL, NULL);
    for (int k = 0; k < m->n_soil_hidden; ++k) {
      const lts_dense *layer = &m->soil_hidden[member * m->n_soil_hidden + k];
      run->dense(layer, a, latent, n, b, latent, LTS_SILU, NULL, NULL);
      float *other = a;
      a = b;
      b = other;
    }
    run->dense(&m->soil_last[member], a, latent, n, soil->out, LTS_PANEL, LTS_NORMED, NULL, NULL);
    for (int i = 0; i < n; ++i) {
      for (int k = 0; k < 3; ++k) mean[3 * i + k] += soil->out[i * LTS_PANEL + k];
    }
  }
  for (int i = 0; i < 3 * n; ++i) mean[i] /= (float)soil->of_particles;
}

void lts_field_place_particles(lts_field *soil) {
  const lts_field_model *m = soil->model;
  const lts_field_head *h = soil->head;
  if (soil->placed) return;
  const float *rest = h->has_bed ? soil->bed : m->rest;
  const int across = 3 - m->axis - m->up, n = find_moving(soil);
  float mean[3 * LTS_FIELD_ROWS];
  memcpy(soil->points, rest, 3 * (size_t)m->n_soil * sizeof *rest);
  if (n) {
    lts_dense shared = m->soil_shared;
    shared.columns = soil->of_particles * LTS_PADDED(m->latent);
    lts_field_read(soil, &m->shared, soil->shared);
    soil->run->dense(&shared, soil->shared, m->n_shared, 1, soil->bias, shared.columns, LTS_NORMED,
                     NULL, NULL);
  }
  for (int done = 0; done < n; done += LTS_FIELD_ROWS) {
    const int rows = n - done < LTS_FIELD_ROWS ? n - done : LTS_FIELD_ROWS;
    displacement(soil, soil->moving + done, rows, mean);
    for (int row = 0; row < rows; ++row) {
      const int i = soil->moving[done + row];
      const float size = m->displacement * soil->gate[done + row], z = soil->z[i] / m->across;
      const float odd = z < -1.0f ? -1.0f : z > 1.0f ? 1.0f : z;
      double old[3], now[3];
      lts_field_plane(m, rest + 3 * i, old);
      for (int k = 0; k < 3; ++k) {
        now[k] = old[k] + (double)(size * mean[3 * row + k] * (k == 2 ? odd : 1.0f));
      }
      soil->tool->push_out(soil, now);
      float *point = soil->points + 3 * i;
      point[m->axis] = (float)(m->sign * now[0]);
      point[m->up] = (float)now[1];
      point[across] = (float)(now[2] + m->middle);
    }
  }
  soil->placed = 1;
}

int lts_field_particles(lts_field *soil, float *out, size_t count) {
  LTS_TRY(lts_field_check_started(soil));
  if (!out) return LTS_ERROR_NULL;
  if (count != (size_t)soil->model->n_soil) return LTS_ERROR_VALUE;
  lts_field_place_particles(soil);
  memcpy(out, soil->points, 3 * count * sizeof *out);
  return LTS_OK;
}

int lts_field_moving(lts_field *soil) {
  const int error = lts_field_check_started(soil);
  return error ? error : find_moving(soil);
}

int lts_field_height_map(lts_field *soil, const lts_grid *grid, float *out) {
  LTS_TRY(lts_field_check_started(soil));
  if (!grid || !out) return LTS_ERROR_NULL;
  LTS_TRY(lts_check_grid(grid));
  lts_field_place_particles(soil);
  lts_clear_heights(grid, out);
  lts_raise_heights(grid, soil->model->up, soil->points, soil->model->n_soil, out);
  return LTS_OK;
}
