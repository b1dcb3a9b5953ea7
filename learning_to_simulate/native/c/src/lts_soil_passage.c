/* One tool on its way over a terrain, from where it was set down. Twin of `soil_field/passage.py`. */
#include <math.h>
#include <string.h>

#include "lts_soil_internal.h"

int lts_soil_n_strip(const lts_soil *soil) {
  return soil->model->n_column > 1 ? soil->model->n_column + 2 * soil->model->n_beside : 1;
}

/* u, height and lean of a pose, in lengths of the field. */
static void seen_pose(const lts_soil *soil, const lts_place *place, const lts_pose *pose, double out[3]) {
  double local[3], turns[3];
  lts_place_local(place, pose->position, local);
  lts_place_laid(place, local, local);
  lts_place_turns(place, pose, turns);
  out[0] = local[0] / soil->scale;
  out[1] = local[1] / soil->scale;
  out[2] = turns[0] - atan(place->grade);
}

int lts_soil_under(const lts_soil *soil, const lts_passage *p, int *first) {
  const int several = p->s.n_strip > 1;
  *first = several ? soil->model->n_beside : 0;
  return several ? soil->model->n_column : 1;
}

static double foremost_of(const lts_soil *soil, const lts_passage *p) {
  int first;
  const int count = lts_soil_under(soil, p, &first);
  double foremost = -HUGE_VAL;
  for (int j = first; j < first + count; ++j) foremost = fmax(foremost, p->s.foremost[j]);
  return foremost;
}

double lts_soil_over(const lts_soil *soil, const lts_passage *p, const double seen[3]) {
  const lts_soil_model *m = soil->model;
  int first;
  const int count = lts_soil_under(soil, p, &first);
  const double middle = (seen[0] - p->s.origin) / m->spacing + m->n_behind;
  const int begin = (int)fmax(middle - m->under / m->spacing, 0.0);
  const int end = (int)fmin(middle + m->under / m->spacing + 2.0, (double)m->n_bin);
  double sum = 0.0;
  for (size_t i = LTS_SOIL_ROW(soil, first); i < LTS_SOIL_ROW(soil, first + count); ++i) sum += p->surface[i];
  double highest = sum / (count * m->n_bin);
  for (int k = begin; k < end; ++k) {
    if (!(fabs(p->s.origin + lts_soil_offset(m, k) - seen[0]) < m->under)) continue;
    for (int j = first; j < first + count; ++j) highest = fmax(highest, p->surface[LTS_SOIL_ROW(soil, j) + (size_t)k]);
  }
  return seen[1] - soil->radius - highest;
}

/* Whether a tool that is seen somewhere is by `lifted`, or at all where it has turned back, over the terrain before it. */
static int lifts(const lts_soil *soil, const lts_passage *p, const double seen[3]) {
  const int is_back = seen[0] < foremost_of(soil, p) - soil->model->turned_back;
  return lts_soil_over(soil, p, seen) > (is_back ? 0.0 : soil->model->lifted);
}

int lts_soil_has_cut(const lts_soil *soil, const lts_passage *p) {
  for (int j = 0; j < p->s.n_strip; ++j) {
    if (p->s.dropped[j] > 0.0) return 1;
  }
  for (size_t i = 0; i < LTS_SOIL_ROW(soil, p->s.n_strip); ++i) {
    if (p->profile[i] < p->surface[i]) return 1;
  }
  return 0;
}

int lts_soil_is_over(const lts_soil *soil, const lts_passage *p) {
  return p->s.lifted && lts_soil_has_cut(soil, p);
}

/* Whether all strips are equal at a place. */
static int is_even(const lts_soil *soil, const lts_place *place, double u) {
  const int n = lts_soil_n_strip(soil);
  double low = HUGE_VAL, high = -HUGE_VAL;
  for (int j = 0; j < n; ++j) {
    const double height = lts_soil_read(soil, soil->terrain, place, n, j, u);
    if (!isfinite(height)) return 0;
    low = height < low ? height : low;
    high = height > high ? height : high;
  }
  return high - low <= soil->model->even;
}

void lts_soil_copy(const lts_soil *soil, lts_passage *to, const lts_passage *from) {
  double *ours[LTS_SOIL_ROWS], *theirs[LTS_SOIL_ROWS];
  lts_soil_rows(to, 0, ours);
  lts_soil_rows(from, 0, theirs);
  to->s = from->s;
  for (int i = 0; i < LTS_SOIL_ROWS; ++i) {
    memcpy(ours[i], theirs[i], LTS_SOIL_ROW(soil, from->s.n_strip) * sizeof(double));
  }
}

double lts_soil_line(const lts_soil *soil, const lts_passage *p, double *height) {
  const lts_soil_model *m = soil->model;
  const double *last = p->surface + LTS_SOIL_ROW(soil, p->s.n_strip - 1);
  const double middle = (lts_soil_offset(m, 0) + lts_soil_offset(m, m->n_bin - 1)) / 2.0;
  double h = 0.0, uh = 0.0, uu = 0.0;
  for (int k = 0; k < m->n_bin; ++k) {
    const double u = lts_soil_offset(m, k) - middle, mean = (p->surface[k] + last[k]) / 2.0;
    h += mean;
    uh += u * mean;
    uu += u * u;
  }
  *height = h / m->n_bin - uh / uu * middle;
  return uh / uu;
}

double lts_soil_whole_grade(const lts_place *place, double slope) {
  return (place->grade + slope) / (1.0 - place->grade * slope);
}

int lts_soil_lay(const lts_soil *soil, const lts_passage *p, double least, lts_place *out) {
  const lts_soil_model *m = soil->model;
  const lts_place old = p->s.place;
  double level;
  const double slope = lts_soil_line(soil, p, &level), grade = lts_soil_whole_grade(&old, slope);
  const double *last = p->surface + LTS_SOIL_ROW(soil, p->s.n_strip - 1);
  *out = old;
  if (!(fabs(slope) > least && fabs(grade) <= m->steep)) return 0;
  for (int k = 0; k < m->n_bin; ++k) {
    const double on = level + slope * lts_soil_offset(m, k);
    if (!(fabs((p->surface[k] + last[k]) / 2.0 - on) <= m->even_slope)) return 0;
  }
  const double over = soil->scale * (level - slope * p->s.origin) - old.height;
  out->grade = grade;
  out->cosine = 1.0 / hypot(1.0, grade);
  out->height = old.height + old.cosine * over + grade * old.grade * old.cosine * over;
  return 1;
}

int lts_soil_is_due(const lts_soil *soil, const lts_passage *p) {
  lts_place other;
  if (foremost_of(soil, p) != p->s.pose[0] || p->s.lifted) return 0;
  return p->s.way > soil->model->renewed_after || lts_soil_lay(soil, p, soil->model->relaid, &other);
}

/* Heights [n_strip][n_bin] of some of the bins about an origin; LTS_ERROR_VALUE: any that are not finite. */
static int read_strips(const lts_soil *soil, const lts_place *place, double origin, int n_strip, int first, int last,
                       double *out) {
  for (int j = 0; j < n_strip; ++j) {
    for (int k = first; k < last; ++k) {
      const double u = origin + lts_soil_offset(soil->model, k);
      const double height = lts_soil_read(soil, soil->terrain, place, n_strip, j, u);
      if (!isfinite(height)) return LTS_ERROR_VALUE;
      out[LTS_SOIL_ROW(soil, j) + (size_t)k] = height;
    }
  }
  return LTS_OK;
}

/* Puts the bins of a passage about a pose that its place sees at `seen`, with one strip as long as `looks` finds the
 * ground even (once off, it stays off), and reads them; LTS_ERROR_VALUE: heights that are not finite. */
static int read_about(const lts_soil *soil, lts_passage *p, const lts_pose *pose, double seen[3]) {
  const lts_soil_model *m = soil->model;
  lts_way *w = &p->s;
  seen_pose(soil, &w->place, pose, seen);
  w->origin = seen[0];
  for (int k = 0; w->looks && k < m->n_bin; ++k) {
    w->looks = is_even(soil, &w->place, seen[0] + lts_soil_offset(m, k));
  }
  w->n_strip = w->looks ? 1 : lts_soil_n_strip(soil);
  return read_strips(soil, &w->place, w->origin, w->n_strip, 0, m->n_bin, p->surface);
}

int lts_soil_begin(lts_soil *soil, lts_passage *p, const lts_pose *pose, int set_down, const lts_place *place) {
  const lts_soil_model *m = soil->model;
  lts_way *w = &p->s;
  const int cells = w->cells;
  memset(w, 0, sizeof *w);
  w->cells = cells;
  w->bears = 1;
  if (place) w->place = *place;
  else if (!lts_place_of(pose, &w->place)) return LTS_ERROR_VALUE;
  lts_terrain_update(soil->terrain);
  double first[3], sum = 0.0, highest = -HUGE_VAL;
  w->looks = m->n_column > 1;
  LTS_TRY(read_about(soil, p, pose, first));
  if (!place && lts_soil_lay(soil, p, m->flat, &w->place)) LTS_TRY(read_about(soil, p, pose, first));
  memcpy(w->pose, first, sizeof first);
  for (size_t i = 0; i < LTS_SOIL_ROW(soil, w->n_strip); ++i) {
    sum += p->surface[i];
    highest = p->surface[i] > highest ? p->surface[i] : highest;
  }
  w->level = sum / (w->n_strip * m->n_bin);
  if (set_down) w->pose[1] = fmax(first[1], highest + soil->radius + m->set_down);
  lts_soil_sweep_start(soil, p);
  if (set_down) lts_soil_advance(soil, p, first, 0.0, 1.0);
  w->lifted = lifts(soil, p, first);
  return LTS_OK;
}

void lts_soil_take_all_strips(const lts_soil *soil, lts_passage *p) {
  double *of[LTS_SOIL_ROWS];
  const int n = lts_soil_n_strip(soil);
  lts_soil_rows(p, 0, of);
  for (int j = 1; j < n; ++j) {
    for (int i = 0; i < LTS_SOIL_ROWS; ++i) {
      memcpy(of[i] + LTS_SOIL_ROW(soil, j), of[i], LTS_SOIL_ROW(soil, 1) * sizeof **of);
    }
    p->s.foremost[j] = p->s.foremost[0];
    p->s.dropped[j] = p->s.dropped[0];
    p->s.begun[j] = p->s.begun[0];
  }
  p->s.n_strip = n;
  p->s.looks = 0;
}

/* Moves the bins to an origin, with what the terrain is there now. */
static int follow(lts_soil *soil, lts_passage *p, double to) {
  const lts_soil_model *m = soil->model;
  const int shift = (int)rint((to - p->s.origin) / m->spacing), n = m->n_bin;
  const int first = shift > 0 ? (shift < n ? n - shift : 0) : 0;
  const int last = shift > 0 ? n : (-shift < n ? -shift : n);
  /* The last chance of cells that the bins leave. */
  lts_terrain_update(soil->terrain);
  p->s.stale = 0;
  int goes_on = p->s.looks;
  for (int k = first; goes_on && k < last; ++k) {
    goes_on = is_even(soil, &p->s.place, to + lts_soil_offset(m, k));
  }
  const int n_strip = p->s.looks && !goes_on ? lts_soil_n_strip(soil) : p->s.n_strip;
  LTS_TRY(read_strips(soil, &p->s.place, to, n_strip, first, last, soil->fresh));
  if (n_strip != p->s.n_strip) lts_soil_take_all_strips(soil, p);
  p->s.owed = lts_soil_owed(soil, p);
  p->s.owed_at = p->s.travelled;
  lts_soil_shift(soil, p, to, shift);
  return LTS_OK;
}

int lts_soil_reach(const lts_soil *soil, const lts_passage *p, const lts_pose *pose, double coming[3],
                   double change[3]) {
  const double turn = 2.0 * LTS_PI;
  seen_pose(soil, &p->s.place, pose, coming);
  for (int i = 0; i < 3; ++i) change[i] = coming[i] - p->s.pose[i];
  change[2] -= turn * floor((change[2] + turn / 2.0) / turn);
  return fabs(change[0]) <= soil->model->max_step ? LTS_OK : LTS_ERROR_JUMP;
}

int lts_soil_go(lts_soil *soil, lts_passage *p, const lts_pose *pose, double dt) {
  const lts_soil_model *m = soil->model;
  double coming[3], change[3];
  LTS_TRY(lts_soil_reach(soil, p, pose, coming, change));
  const int is_lifted = lifts(soil, p, coming);
  if (is_lifted && !soil->writes) return LTS_OK; /* particles stay as they are */
  if (is_lifted && !p->s.lifted) {
    lts_soil_write(soil); /* as the tool leaves it */
    p->s.taken = lts_soil_scooped(soil, p);
  }
  const double to = lts_soil_followed(m, p->s.origin, coming[0]);
  const int moves_on = to != p->s.origin;
  if (moves_on) LTS_TRY(follow(soil, p, to));
  soil->seen = NULL;
  lts_soil_advance(soil, p, coming, lts_soil_turn(soil, change), dt / soil->time);
  /* What is set down straight down on a slope goes back along it: not in the soil. */
  if (p->s.place.grade != 0.0 && !lts_soil_has_cut(soil, p)) {
    for (int j = 0; j < p->s.n_strip; ++j) p->s.foremost[j] = fmin(p->s.foremost[j], p->s.pose[0]);
  }
  p->s.n_gone = 0;
  if (moves_on) lts_soil_look_around(soil, p);
  p->s.stale = 1;
  p->s.lifted = is_lifted;
  return LTS_OK;
}
