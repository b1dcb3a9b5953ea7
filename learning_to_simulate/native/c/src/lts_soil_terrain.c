/* The ground: heights at places and of strips, and what a passage knows of its cells. Twin of
 * `soil_field/terrain.py`, `strips.py` and of the cells of `passage.py`. */
#include <math.h>
#include <string.h>

#include "lts_soil_internal.h"

int lts_terrain_usable(const lts_terrain *t) {
  if (!t || !t->heights) return 0;
  for (int i = 0; i < 2; ++i) {
    if (t->n[i] < 1 || !isfinite(t->corner[i])) return 0;
    if (!(t->cell[i] > 0.0 && isfinite(t->cell[i]))) return 0;
  }
  if ((int64_t)t->n[0] * t->n[1] > INT32_MAX || isnan(t->floor)) return 0;
  return t->friction_angle_deg > 0.0 && t->friction_angle_deg < 90.0 && t->density > 0.0 &&
         isfinite(t->density) && t->gravity > 0.0 && isfinite(t->gravity);
}

/* Lower neighbour of a place in cells, and the share of the way to the upper one. */
static int cell_of(double place, int count, double *share) {
  const double last = count - 1.0;
  const double in = place - 0.5 > 0.0 ? (place - 0.5 < last ? place - 0.5 : last) : 0.0;
  const int most = count > 2 ? count - 2 : 0, low = (int)in < most ? (int)in : most;
  *share = in - low;
  return low;
}

/* Weighted so that a level terrain is level to the last bit. */
double lts_terrain_at(const lts_terrain *t, double x, double z) {
  double a, b;
  const int row = cell_of((x - t->corner[0]) / t->cell[0], t->n[0], &a);
  const int column = cell_of((z - t->corner[1]) / t->cell[1], t->n[1], &b);
  const size_t down = t->n[0] > 1 ? (size_t)t->n[1] : 0, on = t->n[1] > 1;
  const double *h = t->heights + (size_t)row * (size_t)t->n[1] + (size_t)column;
  const double near = h[0] + b * (h[on] - h[0]), far = h[down] + b * (h[down + on] - h[down]);
  return near + a * (far - near);
}

double lts_terrain_ahead(const lts_terrain *t, const lts_place *place, double u) {
  double least = HUGE_VAL;
  for (int i = 0; t->walled && i < 2; ++i) {
    if (!(fabs(place->along[i]) > 1e-12)) continue;
    const double here = place->origin[i] + u * place->along[i];
    const double end = t->corner[i] + (place->along[i] > 0.0 ? t->cell[i] * t->n[i] : 0.0);
    least = fmin(least, (end - here) / place->along[i]);
  }
  return least;
}

double lts_soil_read(const lts_soil *soil, const lts_place *place, int n_strip, int strip, double u) {
  const double centre = n_strip > 1 ? soil->centres[strip] : 0.0;
  const double width = n_strip > 1 ? soil->widths[strip] : soil->width, along = soil->scale * u;
  double sum = 0.0;
  for (int i = 0; i < 5; ++i) {
    const double across = soil->scale * (centre + width * soil->model->across[i]);
    sum += lts_terrain_at(soil->terrain,
                          place->origin[0] + place->along[0] * along + place->across[0] * across,
                          place->origin[1] + place->along[1] * along + place->across[1] * across);
  }
  return sum / 5.0 / soil->scale;
}

int lts_soil_strip_at(const lts_soil *soil, int n_strip, double across, double *share) {
  const double *centres = soil->centres;
  *share = 0.0;
  if (n_strip == 1) return 0;
  int low = 0;
  while (low < n_strip - 2 && centres[low + 1] <= across) ++low;
  const double part = (across - centres[low]) / (centres[low + 1] - centres[low]);
  *share = part > 0.0 ? (part < 1.0 ? part : 1.0) : 0.0;
  return low;
}

/* ---- cells ---- */

static double reach_across(const lts_soil *soil) {
  return soil->width / 2.0 + soil->model->n_beside * soil->model->beside_width;
}

/* First and last row, or column, of the cells that may lie within places low and high along the way. */
static void span_of(const lts_soil *soil, const lts_place *place, double low, double high, int axis,
                    int *first, int *last) {
  const lts_terrain *t = soil->terrain;
  const double reach = reach_across(soil);
  double least = HUGE_VAL, most = -HUGE_VAL;
  for (int corner = 0; corner < 4; ++corner) {
    const double u = soil->scale * (corner & 1 ? high : low);
    const double across = soil->scale * (corner & 2 ? reach : -reach);
    const double at = u * place->along[axis] + across * place->across[axis] + place->origin[axis];
    least = fmin(least, at);
    most = fmax(most, at);
  }
  const double n = t->n[axis];
  *first = (int)fmin(fmax(floor((least - t->corner[axis]) / t->cell[axis]), 0.0), n);
  *last = (int)fmin(fmax(ceil((most - t->corner[axis]) / t->cell[axis]), 0.0), n);
}

void lts_soil_look_around(lts_soil *soil, lts_passage *p) {
  const lts_soil_model *m = soil->model;
  const lts_terrain *t = soil->terrain;
  const lts_place *place = &p->s.place;
  const lts_cells *old = &soil->cells[p->s.cells];
  lts_cells *c = &soil->cells[!p->s.cells];
  const double low = p->s.origin + lts_soil_offset(m, 0);
  const double high = p->s.origin + lts_soil_offset(m, m->n_bin - 1), reach = reach_across(soil);
  int rows[2], columns[2], k = 0, n = 0;
  span_of(soil, place, low, high, 0, rows, rows + 1);
  span_of(soil, place, low, high, 1, columns, columns + 1);
  for (int i = rows[0]; i < rows[1]; ++i) {
    for (int j = columns[0]; j < columns[1] && n < soil->most_cells; ++j) {
      const double point[3] = {t->corner[0] + t->cell[0] * (i + 0.5), 0.0,
                               t->corner[1] + t->cell[1] * (j + 0.5)};
      double local[3];
      lts_place_local(place, point, local);
      const double u = local[0] / soil->scale, across = local[2] / soil->scale;
      if (!(u >= low && u <= high && fabs(across) <= reach)) continue;
      const int32_t number = i * t->n[1] + j;
      while (k < old->n && old->number[k] < number) ++k;
      const int is_known = k < old->n && old->number[k] == number;
      c->number[n] = number;
      c->before[n] = is_known ? old->before[k] : t->heights[number];
      c->left[n] = is_known ? old->left[k] : t->heights[number];
      c->u[n] = u;
      c->across[n++] = across;
    }
  }
  c->n = n;
  p->s.cells = !p->s.cells;
}

/* Of the cells about the tool: what `lts_soil_find` asks for. */
typedef struct {
  const lts_cells *cells;
  const int32_t *which;
  double origin;
} near_cells;

static void place_of_cell(const void *of, size_t i, double out[3]) {
  const near_cells *near = of;
  const int32_t k = near->which[i];
  out[0] = near->cells->u[k] - near->origin;
  out[1] = 0.0;
  out[2] = near->cells->across[k];
}

void lts_soil_write(lts_soil *soil) {
  lts_passage *p = &soil->passage[soil->now];
  const lts_soil_model *m = soil->model;
  if (!soil->started || !soil->writes || !p->s.stale) return;
  p->s.stale = 0;
  lts_cells *c = &soil->cells[p->s.cells];
  double *heights = soil->terrain->heights;
  const double reach = m->window + m->chunk * m->spacing;
  int32_t n = 0;
  for (int32_t k = 0; k < c->n; ++k) {
    if (!(fabs(c->u[k] - p->s.pose[0]) <= reach)) continue;
    /* What others have changed there since stays. */
    c->before[k] += heights[c->number[k]] - c->left[k];
    soil->near[n++] = k;
  }
  const near_cells near = {c, soil->near, p->s.origin};
  lts_soil_find(soil, p, 1, (size_t)n, place_of_cell, &near, soil->risen);
  for (int32_t i = 0; i < n; ++i) {
    const int32_t k = soil->near[i];
    const double h = c->before[k] + (double)((float)soil->scale * soil->risen[i]);
    c->left[k] = heights[c->number[k]] = h < soil->terrain->floor ? soil->terrain->floor : h;
  }
}

int lts_terrain_update(lts_terrain *t) {
  if (!t) return LTS_ERROR_NULL;
  for (lts_soil *soil = t->first; soil; soil = soil->next) lts_soil_write(soil);
  return LTS_OK;
}
