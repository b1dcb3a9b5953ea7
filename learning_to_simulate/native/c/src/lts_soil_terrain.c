/* The ground: heights at places and of strips, and what a passage knows of its cells. Twin of
 * `soil_field/terrain.py`, `place.py` and of the cells of `passage.py`. */
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

double lts_terrain_wall(const lts_terrain *t, const double here[2], const double way[2]) {
  double least = HUGE_VAL;
  for (int i = 0; t->walled && i < 2; ++i) {
    if (!(fabs(way[i]) > 1e-12)) continue;
    least = fmin(least, (t->corner[i] + (way[i] > 0.0 ? t->cell[i] * t->n[i] : 0.0) - here[i]) / way[i]);
  }
  return least;
}

double lts_soil_read(const lts_soil *soil, const lts_terrain *terrain, const lts_place *place, int n_strip,
                     int strip, double u) {
  const double centre = n_strip > 1 ? soil->centres[strip] : 0.0;
  const double width = n_strip > 1 ? soil->widths[strip] : soil->width;
  const double c = place->cosine, along = soil->scale * c * u, ground = place->height / soil->scale;
  double sum = 0.0;
  for (int i = 0; i < 5; ++i) {
    const double across = soil->scale * (centre + width * soil->model->across[i]);
    sum += lts_terrain_at(terrain,
                          place->origin[0] + place->along[0] * along + place->across[0] * across,
                          place->origin[1] + place->along[1] * along + place->across[1] * across);
  }
  return ground + c * (sum / 5.0 / soil->scale - ground - place->grade * c * u);
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

/* Corners [4] (x, z, m) of what lies between the first and the last bin and near enough across. */
static void corners_in_sight(const lts_soil *soil, const lts_passage *p, double out[4][2]) {
  const lts_soil_model *m = soil->model;
  const lts_place *place = &p->s.place;
  const double reach = reach_across(soil);
  for (int corner = 0; corner < 4; ++corner) {
    const double end = p->s.origin + lts_soil_offset(m, corner & 2 ? m->n_bin - 1 : 0);
    const double u = soil->scale * place->cosine * end;
    const double across = soil->scale * (corner & 1 ? reach : -reach);
    for (int i = 0; i < 2; ++i) {
      out[corner][i] = u * place->along[i] + across * place->across[i] + place->origin[i];
    }
  }
}

/* Takes a cell into the rows and columns from low to high. */
static void span_cell(const lts_terrain *t, int32_t cell, int low[2], int high[2]) {
  const int at[2] = {cell / t->n[1], cell % t->n[1]};
  for (int i = 0; i < 2; ++i) {
    low[i] = at[i] < low[i] ? at[i] : low[i];
    high[i] = at[i] > high[i] ? at[i] : high[i];
  }
}

int lts_soil_footprint(const lts_soil *soil, double *out) {
  double corners[4][2];
  LTS_TRY(lts_soil_check_started(soil));
  if (!out) return LTS_ERROR_NULL;
  corners_in_sight(soil, &soil->passage[soil->now], corners);
  out[2] = 0.0;
  for (int i = 0; i < 2; ++i) {
    out[i] = (corners[0][i] + corners[1][i] + corners[2][i] + corners[3][i]) / 4.0;
  }
  for (int k = 0; k < 4; ++k) {
    out[2] = fmax(out[2], hypot(corners[k][0] - out[0], corners[k][1] - out[1]));
  }
  return LTS_OK;
}

/* First and last row, or column, of the cells that may lie between corners. */
static void span_of(const lts_terrain *t, double corners[4][2], int axis, int *first, int *last) {
  double least = HUGE_VAL, most = -HUGE_VAL;
  for (int k = 0; k < 4; ++k) {
    least = fmin(least, corners[k][axis]);
    most = fmax(most, corners[k][axis]);
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
  int rows[2], columns[2], k = 0, n = 0, n_gone = 0;
  double corners[4][2], risen = 0.0, dropped = 0.0;
  corners_in_sight(soil, p, corners);
  span_of(t, corners, 0, rows, rows + 1);
  span_of(t, corners, 1, columns, columns + 1);
#define PASS_BY(condition)                                 \
  for (; k < old->n && (condition); ++k) {                 \
    risen += t->heights[old->number[k]] - old->before[k];  \
    soil->gone[n_gone++] = old->number[k];                 \
  }
  for (int i = rows[0]; i < rows[1]; ++i) {
    for (int j = columns[0]; j < columns[1] && n < soil->most_cells; ++j) {
      const double point[3] = {t->corner[0] + t->cell[0] * (i + 0.5), 0.0,
                               t->corner[1] + t->cell[1] * (j + 0.5)};
      double local[3];
      lts_place_local(place, point, local);
      const double u = local[0] / soil->scale / place->cosine, across = local[2] / soil->scale;
      if (!(u >= low && u <= high && fabs(across) <= reach)) continue;
      const int32_t number = i * t->n[1] + j;
      PASS_BY(old->number[k] < number)
      const int is_known = k < old->n && old->number[k] == number;
      c->number[n] = number;
      c->before[n] = is_known ? old->before[k] : t->heights[number];
      c->left[n] = is_known ? old->left[k] : t->heights[number];
      c->u[n] = u;
      c->across[n++] = across;
      k += is_known;
    }
  }
  PASS_BY(1)
#undef PASS_BY
  int under;
  const int count = lts_soil_under(soil, p, &under);
  for (int j = under; j < under + count; ++j) dropped += p->s.dropped[j];
  p->s.left_behind += t->cell[0] * t->cell[1] / (soil->scale * soil->scale) * risen / soil->scale;
  p->s.dropped_there = dropped / count;
  p->s.n_gone = n_gone;
  c->n = n;
  p->s.cells = !p->s.cells;
}

/* Whether any cell in sight may be another than the passage has left it: bytes are compared, by runs of cells that
 * follow one another in a row, whose lengths hardly differ from row to row. */
static int may_have_changed(const lts_terrain *t, const lts_cells *c) {
  int32_t run = 1;
  for (int32_t k = 0; k < c->n; k += run) {
    const int32_t *number = c->number + k;
    run = run < c->n - k ? run : c->n - k;
    while (number[run - 1] - number[0] != run - 1) --run;
    while (k + run < c->n && number[run] - number[0] == run) ++run;
    if (memcmp(t->heights + number[0], c->left + k, (size_t)run * sizeof *c->left)) return 1;
  }
  return 0;
}

int lts_soil_meet(lts_soil *soil, lts_passage *p) {
  const lts_soil_model *m = soil->model;
  const lts_terrain *t = soil->terrain;
  lts_cells *c = &soil->cells[p->s.cells];
  int low[2] = {INT32_MAX, INT32_MAX}, high[2] = {-1, -1};
  if (!may_have_changed(t, c)) return LTS_OK;
  for (int32_t k = 0; k < c->n; ++k) {
    const double h = t->heights[c->number[k]];
    if (h == c->left[k]) continue;
    if (!isfinite(h)) return LTS_ERROR_VALUE;
    span_cell(t, c->number[k], low, high);
  }
  if (high[0] < 0) return LTS_OK; /* a 0 with another sign */
  /* What has changed, as a terrain of its own with nothing about it. */
  lts_terrain box = *t;
  lts_place bare = p->s.place; /* changes of height, not heights over its ground */
  bare.grade = bare.height = 0.0;
  box.heights = soil->box;
  for (int i = 0; i < 2; ++i) {
    box.n[i] = high[i] - low[i] + 3;
    box.corner[i] = t->corner[i] + t->cell[i] * (low[i] - 1);
  }
  memset(soil->box, 0, (size_t)box.n[0] * (size_t)box.n[1] * sizeof *soil->box);
  for (int32_t k = 0; k < c->n; ++k) {
    const double change = t->heights[c->number[k]] - c->left[k];
    if (change == 0.0) continue;
    const int i = c->number[k] / t->n[1] - low[0] + 1, j = c->number[k] % t->n[1] - low[1] + 1;
    soil->box[(size_t)i * (size_t)box.n[1] + (size_t)j] = change;
    c->before[k] += change;
    c->left[k] += change;
  }
  const int all = lts_soil_n_strip(soil), under = all > 1 ? m->n_beside : 0;
  int uneven = 0;
  for (int k = 0; k < m->n_bin; ++k) {
    double least = HUGE_VAL, most = -HUGE_VAL;
    for (int j = 0; j < all; ++j) {
      const double u = p->s.origin + lts_soil_offset(m, k);
      const double read = lts_soil_read(soil, &box, &bare, all, j, u);
      soil->fresh[LTS_SOIL_ROW(soil, j) + (size_t)k] = read;
      least = fmin(least, read);
      most = fmax(most, read);
    }
    uneven |= most - least > m->even;
  }
  if (p->s.looks && uneven) lts_soil_take_all_strips(soil, p);
  for (int j = 0; j < p->s.n_strip; ++j) {
    for (int k = 0; k < m->n_bin; ++k) {
      const size_t i = LTS_SOIL_ROW(soil, j) + (size_t)k;
      double change = soil->fresh[i];
      if (p->s.n_strip != all) {
        change = 0.0;
        for (int s = 0; s < m->n_column; ++s) change += soil->fresh[LTS_SOIL_ROW(soil, under + s) + (size_t)k];
        change /= m->n_column;
      }
      p->surface[i] += change;
      p->profile[i] += change;
    }
  }
  soil->seen = NULL;
  return LTS_OK;
}

int lts_soil_meet_others(lts_soil *soil) {
  lts_terrain *t = soil->terrain;
  double here[3], there[3];
  lts_soil_footprint(soil, here);
  for (const lts_soil *other = t->first; other; other = other->next) {
    if (other == soil || !other->started || !other->writes) continue;
    lts_soil_footprint(other, there);
    if (!(hypot(there[0] - here[0], there[1] - here[1]) < here[2] + there[2])) continue;
    lts_terrain_update(t);
    break;
  }
  return lts_soil_meet(soil, &soil->passage[soil->now]);
}

/* Whether no soil leaves the map. */
static int keeps_volume(const lts_soil *soil, const lts_passage *p) {
  const lts_terrain *t = soil->terrain;
  double corners[4][2];
  if (t->walled) return 1;
  corners_in_sight(soil, p, corners);
  for (int k = 0; k < 4; ++k) {
    for (int i = 0; i < 2; ++i) {
      const double from = corners[k][i] - t->corner[i];
      if (!(from >= 0.0 && from <= t->cell[i] * t->n[i])) return 0;
    }
  }
  return 1;
}

/* Of the cells in sight: what `lts_soil_find` asks for. */
typedef struct {
  const lts_cells *cells;
  double origin;
} cells_in_sight;

static void place_of_cell(const void *of, size_t k, double out[3]) {
  const cells_in_sight *sight = of;
  out[0] = sight->cells->u[k] - sight->origin;
  out[1] = 0.0;
  out[2] = sight->cells->across[k];
}

void lts_soil_write(lts_soil *soil) {
  lts_passage *p = &soil->passage[soil->now];
  const lts_soil_model *m = soil->model;
  const lts_terrain *t = soil->terrain;
  if (!soil->started || !soil->writes) return;
  if (lts_soil_meet(soil, p) || !p->s.stale || p->s.lifted) return;
  p->s.stale = 0;
  lts_cells *c = &soil->cells[p->s.cells];
  const cells_in_sight sight = {c, p->s.origin};
  lts_soil_find(soil, p, 1, (size_t)c->n, place_of_cell, &sight, soil->risen);
  double up = 0.0, down = 0.0, factor = 1.0;
  const double cosine = p->s.place.cosine;
  if (keeps_volume(soil, p)) { /* (20) */
    for (int32_t k = 0; k < c->n; ++k) {
      const double rise = soil->risen[k] / cosine;
      up += rise > 0.0 ? rise : 0.0;
      down -= rise < 0.0 ? rise : 0.0;
    }
    const double cell = t->cell[0] * t->cell[1] / (soil->scale * soil->scale);
    factor = (down - p->s.left_behind / cell) / fmax(up, 1e-12);
    factor = fmin(fmax(factor, m->factor[0]), m->factor[1]);
  }
  for (int32_t k = 0; k < c->n; ++k) {
    const double rise = soil->risen[k] / cosine;
    const double h = c->before[k] + soil->scale * (rise > 0.0 ? factor * rise : rise);
    c->left[k] = t->heights[c->number[k]] = h < t->floor ? t->floor : h;
  }
}

int lts_terrain_update(lts_terrain *t) {
  if (!t) return LTS_ERROR_NULL;
  for (lts_soil *soil = t->first; soil; soil = soil->next) lts_soil_write(soil);
  return LTS_OK;
}

/* ---- slides ---- */

/* Rows and columns about cells, with a margin. */
static void box_about(const lts_terrain *t, const int least[2], const int most[2], const int margin[2],
                      int low[2], int high[2]) {
  for (int i = 0; i < 2; ++i) {
    low[i] = least[i] - margin[i] > 0 ? least[i] - margin[i] : 0;
    high[i] = most[i] + 1 < t->n[i] - margin[i] ? most[i] + margin[i] + 1 : t->n[i];
  }
}

/* Slides between neighbours at some offsets, all at once: so much of what is too steep moves from the higher one to
 * the lower. Returns the largest height by which any was too steep. */
static double slide(const lts_soil *soil, const int low[2], const int high[2], const int (*ways)[2], int n_way,
                    double share, double friction) {
  const lts_terrain *t = soil->terrain;
  const size_t width = (size_t)(high[1] - low[1]);
  double *now = soil->moved[0], *next = soil->moved[1], most = 0.0; /* of this row and of the next one */
  memset(now, 0, width * sizeof *now);
  for (int i = low[0]; i < high[0]; ++i) {
    double *const row = t->heights + (size_t)i * (size_t)t->n[1] + low[1];
    memset(next, 0, width * sizeof *next);
    for (int w = 0; w < n_way; ++w) {
      const int dx = ways[w][0], dz = ways[w][1];
      if (i + dx >= high[0]) continue;
      const double steepest = friction * hypot(t->cell[0] * dx, t->cell[1] * dz);
      const double *other = row + dx * t->n[1];
      const unsigned char *kept = soil->kept + (row - t->heights), *other_kept = kept + dx * t->n[1];
      double *to = dx ? next : now;
      for (int j = dz < 0; j < (int)width - (dz > 0); ++j) {
        const double fall = row[j] - other[j + dz];
        if ((fall <= steepest && fall >= -steepest) || kept[j] || other_kept[j + dz]) continue;
        const double excess = fall - (fall > steepest ? steepest : -steepest);
        now[j] -= share * excess;
        to[j + dz] += share * excess;
        most = fmax(most, fabs(excess));
      }
    }
    for (size_t j = 0; j < width; ++j) row[j] += now[j];
    double *const done = now;
    now = next;
    next = done;
  }
  return most;
}

void lts_soil_settle(lts_soil *soil, const int32_t *cells, int32_t n, const lts_passage *kept) {
  const lts_soil_model *m = soil->model;
  const lts_terrain *t = soil->terrain;
  const int pairs[4][2] = {{1, 0}, {0, 1}, {1, 1}, {1, -1}}, one[2] = {1, 1};
  int least[2] = {INT32_MAX, INT32_MAX}, last[2] = {-1, -1}, low[2], high[2], margin[2];
  double lowest = HUGE_VAL, highest = -HUGE_VAL;
  if (!n) return;
  for (int32_t k = 0; k < n; ++k) span_cell(t, cells[k], least, last);
  box_about(t, least, last, one, low, high);
  for (int i = low[0]; i < high[0]; ++i) {
    for (int j = low[1]; j < high[1]; ++j) {
      const double h = t->heights[(size_t)i * (size_t)t->n[1] + (size_t)j];
      lowest = fmin(lowest, h);
      highest = fmax(highest, h);
    }
  }
  /* As far as a heap of all that stands out here runs. */
  const double friction = tan(t->friction_angle_deg * LTS_PI / 180.0);
  for (int i = 0; i < 2; ++i) {
    const double run = ceil((highest - lowest) / (friction * t->cell[i])) + 1.0;
    margin[i] = (int)fmax(fmin(run, (double)t->n[i]), 1.0);
  }
  box_about(t, least, last, margin, low, high);
  const lts_cells *stay = kept ? &soil->cells[kept->s.cells] : NULL;
  for (int32_t k = 0; stay && k < stay->n; ++k) soil->kept[stay->number[k]] = 1;
  for (int round = 0; round < m->slides; ++round) {
    double most = 0.0;
    for (int i = 0; i < 3; ++i) { /* along x, along z, both diagonals */
      const double slid = slide(soil, low, high, &pairs[i], i < 2 ? 1 : 2, m->slide_shares[i], friction);
      most = fmax(most, slid);
    }
    if (most <= m->slope_tolerance) break;
  }
  for (int32_t k = 0; stay && k < stay->n; ++k) soil->kept[stay->number[k]] = 0;
}
