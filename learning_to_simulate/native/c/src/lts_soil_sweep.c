/* What a tool has swept, and how the networks see it. Twin of `soil_field/sweep.py`, for strips that share their
 * path; numbers of docs/soil_field.md. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lts_soil_internal.h"

double lts_soil_offset(const lts_soil_model *m, int bin) { return m->spacing * (bin - m->n_behind); }

/* Where the bins' origin goes when the tool goes to u = tip: by whole chunks, and no farther than needed. */
double lts_soil_followed(const lts_soil_model *m, double origin, double tip) {
  const double chunk = m->chunk * m->spacing, offset = tip - origin;
  const double on = fmax(ceil((offset - m->on) / chunk), 0.0);
  const double back = fmax(ceil((-m->back - offset) / chunk), 0.0);
  return origin + chunk * (on - back);
}

/* x of (7): of a blade a length times its change of lean, of a wheel the slip of its rim. */
double lts_soil_turn(const lts_soil *soil, const double change[3]) {
  const lts_soil_model *m = soil->model;
  return m->kind == LTS_SOIL_WHEEL ? -m->rim * change[2] - change[0] : m->lean_length * change[2];
}

/* The state before any motion, on surfaces that are there, at the pose and origin that are there. */
void lts_soil_sweep_start(lts_soil *soil, lts_passage *p) {
  const size_t n = LTS_SOIL_ROW(soil, p->s.n_strip);
  memcpy(p->profile, p->surface, n * sizeof *p->profile);
  for (size_t k = 0; k < n; ++k) {
    p->last[k] = -soil->model->forget;
    p->area_before[k] = p->struck[k] = 0.0;
  }
  memset(p->s.memory, 0, sizeof p->s.memory);
  p->s.travelled = p->s.way = p->s.speed = 0.0;
  for (int j = 0; j < p->s.n_strip; ++j) {
    p->s.foremost[j] = p->s.pose[0];
    p->s.dropped[j] = p->s.begun[j] = 0.0;
  }
}

/* Sum of cuts from one bin to before another. Eight sums, because one would wait for itself. */
static double sum_of_cuts(const double *surface, const double *profile, int low, int high) {
  double sums[8] = {0.0}, sum = 0.0;
  int k = low;
  for (; k + 8 <= high; k += 8) {
    for (int i = 0; i < 8; ++i) sums[i] += surface[k + i] - profile[k + i];
  }
  for (; k < high; ++k) sum += surface[k] - profile[k];
  for (int i = 0; i < 8; ++i) sum += sums[i];
  return sum;
}

double lts_soil_owed(const lts_soil *soil, const lts_passage *p) {
  const lts_way *w = &p->s;
  const double goal = -w->left_behind / soil->width - w->dropped_there;
  const double way = (w->travelled - w->owed_at) / (soil->model->chunk * soil->model->spacing);
  return w->owed + (way < 1.0 ? way : 1.0) * (goal - w->owed);
}

/* Moves the bins; the heights of new ones are those of `fresh`. */
void lts_soil_shift(lts_soil *soil, lts_passage *p, double origin, int shift) {
  const int n = soil->model->n_bin, kept = shift > -n && shift < n ? n - abs(shift) : 0;
  const size_t from = shift > 0 ? (size_t)shift : 0, to = shift < 0 ? (size_t)-shift : 0;
  const int first = shift > 0 ? kept : 0; /* of the new bins */
  for (int j = 0; j < p->s.n_strip; ++j) {
    const size_t row = LTS_SOIL_ROW(soil, j);
    double *of[LTS_SOIL_ROWS];
    lts_soil_rows(p, row, of);
    const int lost = shift > 0 ? 0 : kept; /* the first bin that is dropped */
    p->s.dropped[j] += soil->model->spacing * sum_of_cuts(of[0], of[1], lost, lost + n - kept);
    for (int i = 0; kept && i < LTS_SOIL_ROWS; ++i) {
      memmove(of[i] + to, of[i] + from, (size_t)kept * sizeof **of);
    }
    for (int k = first; k < first + n - kept; ++k) {
      of[0][k] = of[1][k] = soil->fresh[row + (size_t)k];
      of[2][k] = p->s.travelled - soil->model->forget;
      of[3][k] = of[4][k] = 0.0;
    }
  }
  p->s.origin = origin;
}

/* (4), of one strip. */
static double area(const lts_soil *soil, const lts_passage *p, int strip) {
  const lts_soil_model *m = soil->model;
  const double *s = p->surface + LTS_SOIL_ROW(soil, strip), *q = p->profile + LTS_SOIL_ROW(soil, strip);
  const double from = p->s.pose[0] - p->s.origin, reach = m->window / m->spacing, du = m->spacing;
  const double middle = from / m->spacing + m->n_behind;
  const int low = (int)fmax(middle - reach + 1.0, 0.0);
  const int high = (int)fmin(middle + reach - 1.0, m->n_bin - 1.0);
  /* Within all bins count in full; those about the ends by their share. */
  double sum = sum_of_cuts(s, q, low + 1, high);
  const int ends[2][2] = {{low - 2, low}, {high > low ? high : low + 1, high + 3}};
  for (int end = 0; end < 2; ++end) {
    for (int k = ends[end][0] > 0 ? ends[end][0] : 0; k <= ends[end][1] && k < m->n_bin; ++k) {
      const double away = fabs(p->s.origin + lts_soil_offset(m, k) - p->s.pose[0]);
      const double share = (m->window - away) / du + 0.5;
      sum += (share > 0.0 ? (share < 1.0 ? share : 1.0) : 0.0) * (s[k] - q[k]);
    }
  }
  return du * sum;
}

/* (24), of one strip. */
static double layer(const lts_soil *soil, const lts_passage *p, int strip) {
  const lts_soil_model *m = soil->model;
  const size_t row = LTS_SOIL_ROW(soil, strip);
  const double *s = p->surface + row, *q = p->profile + row, *struck = p->struck + row;
  double sum = 0.0;
  for (int k = 0; k < m->n_bin; ++k) {
    if (!(struck[k] > 0.0 && struck[k] < m->strikes)) continue; /* nothing is left */
    const double uncut = 1.0 - fmin((s[k] - q[k]) / m->touch, 1.0);
    sum += uncut * fmin(struck[k] / m->touch, 1.0) * (m->strikes - struck[k]);
  }
  return m->spacing * sum;
}

/* (26), of strips [j] under the tool; those beside it have no back. */
static void find_pressed(const lts_soil *soil, const lts_passage *p, double found[LTS_SOIL_STRIPS]) {
  const lts_soil_model *m = soil->model;
  const lts_soil_tool *tool = &soil->tool;
  const int is_bucket = tool->bucket > 0.0;
  int under;
  const int count = lts_soil_under(soil, p, &under);
  for (int j = 0; j < p->s.n_strip; ++j) found[j] = 0.0;
  if (m->kind != LTS_SOIL_BLADE) return;
  const double right = 0.5 * LTS_PI; /* `Blade.back` */
  const double least = is_bucket ? m->floor_falls : 0.0;
  const double angle = fmin(fmax((is_bucket ? tool->floor_deg * LTS_PI / 180.0 : right) - p->s.pose[2], least), right);
  const double length = fmax((is_bucket ? tool->floor_share : 1.0) * tool->length - 2.0 * tool->radius, 0.0);
  const double sine = sin(angle), cosine = cos(angle), du = m->spacing, last = length / soil->scale * cosine;
  const double rises = sine / fmax(cosine, 1e-9), slope = fabs(rises) > 1e-6 ? rises : 1e-6;
  const double from = p->s.pose[0] - p->s.origin - soil->radius * sine; /* where it leaves the circle */
  const double level = p->s.pose[1] - soil->radius * cosine;
  const int begin = (int)fmax(floor((from - last) / du) + m->n_behind, 0.0);
  const int end = (int)fmin(ceil(from / du) + m->n_behind + 1.0, (double)m->n_bin);
  for (int j = under; j < under + count; ++j) {
    const double *q = p->profile + LTS_SOIL_ROW(soil, j);
    double sum = 0.0;
    for (int k = begin; k < end; ++k) {
      const double behind = from - lts_soil_offset(m, k);
      for (int side = -1; side < 2; side += 2) { /* where the part of the back in the bin begins and ends */
        const double depth = q[k] - level - slope * fmin(fmax(behind + 0.5 * side * du, 0.0), last);
        if (depth > 0.0) sum -= side * depth * depth;
      }
    }
    found[j] = sum / (2.0 * slope);
  }
}

/* Lowest height at `u` of a circle that goes straight between two centres; infinite where it has not been: (1). */
static double underside(double u, const double before[2], const double after[2], double radius) {
  const double *centres[2] = {before, after};
  double height = HUGE_VAL;
  for (int end = 0; end < 2; ++end) {
    const double depth = radius - fabs(u - centres[end][0]);
    const double square = depth * (2.0 * radius - depth);
    if (!(square >= 0.0)) continue;
    const double circle = centres[end][1] - sqrt(square);
    height = circle < height ? circle : height;
  }
  const double step[2] = {after[0] - before[0], after[1] - before[1]}, width = fabs(step[0]);
  if (!(width > 0.0)) return height;
  /* The tangent: the way moved by the radius along its normal that looks down. */
  const double length = hypot(step[0], step[1]), sign = step[0] < 0.0 ? -1.0 : 1.0;
  const double along = (u - (before[0] + radius * (sign * step[1] / length))) * sign;
  if (!(along >= 0.0 && along <= width)) return height;
  const double left = before[1] + radius * (-sign * step[0] / length);
  const double tangent = left + along / width * step[1];
  return tangent < height ? tangent : height;
}

void lts_soil_advance(lts_soil *soil, lts_passage *p, const double pose[3], double turn, double dt) {
  const lts_soil_model *m = soil->model;
  lts_way *w = &p->s;
  const double step[2] = {pose[0] - w->pose[0], pose[1] - w->pose[1]};
  const double length = hypot(step[0], step[1]), ds = length + fabs(turn);
  /* Bins that the circle may have passed. */
  const double least = fmin(w->pose[0], pose[0]) - soil->radius - w->origin;
  const double most = fmax(w->pose[0], pose[0]) + soil->radius - w->origin;
  const int begin = (int)fmax(floor(least / m->spacing) + m->n_behind, 0.0);
  const int end = (int)fmin(ceil(most / m->spacing) + m->n_behind + 1.0, (double)m->n_bin);
  for (int k = begin; k < end; ++k) {
    soil->under[k] = underside(w->origin + lts_soil_offset(m, k), w->pose, pose, soil->radius);
  }
  w->travelled += length;
  for (int j = 0; j < w->n_strip; ++j) {
    const size_t row = LTS_SOIL_ROW(soil, j);
    double *surface = p->surface + row, *profile = p->profile + row, *struck = p->struck + row;
    double before = -1.0, left = -1.0, deepest = 0.0, below = 0.0;
    int passed = 0;
    for (int k = begin; k < end; ++k) {
      const double height = soil->under[k];
      if (!(height < surface[k])) {
        if (height < surface[k] + m->strikes && !(struck[k] > 0.0) && !(profile[k] < surface[k])) {
          /* (6): what the tool passes over without a cut may come from what it has left. */
          if (before < 0.0) before = area(soil, p, j);
          if (left < 0.0) left = layer(soil, p, j);
          p->area_before[row + (size_t)k] = fmax(before - left, 0.0);
        }
        continue;
      }
      passed = 1;
      below = fmax(below, surface[k] - height);
      p->last[row + (size_t)k] = w->travelled; /* (5) */
      if (!(profile[k] < surface[k])) {
        /* (6): the area before this frame, so that what is cut together has one value. */
        if (before < 0.0) before = area(soil, p, j);
        p->area_before[row + (size_t)k] = before;
      }
    }
    /* (2), after all areas before. */
    for (int k = begin; passed && k < end; ++k) {
      if (soil->under[k] < profile[k]) profile[k] = soil->under[k];
      deepest = fmax(deepest, surface[k] - profile[k]);
    }
    w->begun[j] = fmax(w->begun[j], fmin(deepest / m->touch, 1.0));
    for (int k = begin; w->begun[j] > 0.0 && k < end; ++k) { /* (23) */
      const double over = w->begun[j] * fmin(surface[k] + m->strikes - soil->under[k], m->strikes);
      struck[k] = fmax(struck[k], over);
    }
    /* (27): in the soil the tool makes itself a new foremost place. */
    const double at = pose[0] - (1.0 - fmin(below / m->graze, 1.0)) * (pose[0] - w->foremost[j]);
    w->foremost[j] = fmin(fmax(w->foremost[j], at), pose[0] + m->forget);
  }
  const double motion[LTS_SOIL_MOTIONS] = {step[0], step[1], turn, ds * ds / dt}, share = fmax(ds, 1e-30);
  for (int i = 0; i < LTS_SOIL_MEMORIES; ++i) { /* (7) */
    const double fade = exp(-ds / m->memories[i]);
    for (int k = 0; k < LTS_SOIL_MOTIONS; ++k) {
      w->memory[i][k] = fade * w->memory[i][k] + (1.0 - fade) * (motion[k] / share);
    }
  }
  memcpy(w->pose, pose, sizeof w->pose);
  w->way += ds;
  w->speed = ds / dt;
}

/* The largest of all values, each lowered by `fall` per bin of distance; in place. */
static void cone(double *values, int n, double fall) {
  for (int k = 1; k < n; ++k) {
    const double other = values[k - 1] - fall;
    values[k] = other > values[k] ? other : values[k];
  }
  for (int k = n - 2; k >= 0; --k) {
    const double other = values[k + 1] - fall;
    values[k] = other > values[k] ? other : values[k];
  }
}

/* What places see of the way behind, which the load does not. */
static void see_past(lts_soil *soil, const lts_passage *p, size_t row) {
  const lts_soil_model *m = soil->model;
  const double *surface = p->surface + row, *profile = p->profile + row, *struck = p->struck + row;
  double *touched = soil->first, *depth = soil->second;
  for (int k = 0; k < m->n_bin; ++k) {
    const size_t i = row + (size_t)k;
    const double way = fmin(p->s.travelled - p->last[i], m->forget);
    depth[k] = surface[k] - profile[k];
    touched[k] = fmin(fmax(depth[k], struck[k]) / m->touch, 1.0);
    soil->bins[LTS_SOIL_SINCE][i] = (float)(m->forget - fmin(depth[k] / m->touch, 1.0) * (m->forget - way)); /* (5) */
    soil->bins[LTS_SOIL_AREA_BEFORE][i] = (float)p->area_before[i];
    soil->bins[LTS_SOIL_STRUCK][i] = (float)struck[k];
  }
  cone(touched, m->n_bin, m->spacing / m->reach);
  cone(depth, m->n_bin, m->rise * m->spacing);
  for (int k = 0; k < m->n_bin; ++k) {
    const double influence = 3.0 * touched[k]; /* (8) */
    soil->bins[LTS_SOIL_INFLUENCE][row + (size_t)k] =
        (float)(influence > 0.0 ? (influence < 1.0 ? influence : 1.0) : 0.0);
    soil->bins[LTS_SOIL_DISTURBED][row + (size_t)k] = (float)depth[k]; /* (9) */
  }
}

static void see_scalars(lts_soil *soil, const lts_passage *p) {
  const lts_soil_model *m = soil->model;
  const lts_way *w = &p->s;
  const double c = w->place.cosine, ground = w->place.height / soil->scale;
  const double *along = w->place.along, on = soil->scale * c * w->pose[0], back[2] = {-along[0], -along[1]};
  const double here[2] = {w->place.origin[0] + on * along[0], w->place.origin[1] + on * along[1]};
  const double ahead = lts_terrain_wall(soil->terrain, here, along) / soil->scale;
  const double behind = lts_terrain_wall(soil->terrain, here, back) / soil->scale;
  const double height = ground + c * (w->pose[1] - ground + w->place.grade * w->pose[0]);
  const double below = height - soil->radius - soil->terrain->floor / soil->scale;
  const double owed = lts_soil_owed(soil, p);
  /* A soil farther from those that were taught than half of their range is as the nearest one that is not, and a
   * tool that is faster than any feels what the fastest did. */
  const double *low = m->limits + 2 * (size_t)m->n_judged, *high = low + m->n_judged;
  const double fastest = high[LTS_SOIL_JUDGED_SPEED];
  const int of_soil[] = {LTS_SOIL_FRICTION, LTS_SOIL_STRESS(m)};
  double pressed[LTS_SOIL_STRIPS];
  find_pressed(soil, p, pressed);
  for (int j = 0; j < w->n_strip; ++j) {
    float *s = soil->scalars[j];
    s[LTS_SOIL_TIP] = (float)(w->pose[0] - w->origin);
    s[LTS_SOIL_HEIGHT] = (float)(w->pose[1] - w->level);
    s[LTS_SOIL_LEAN] = (float)w->pose[2];
    s[LTS_SOIL_AREA] = (float)area(soil, p, j);
    /* Farther behind, as of a tool that goes on in the air, it tells nothing of what is near. */
    s[LTS_SOIL_FOREMOST] = (float)(fmax(w->foremost[j], w->pose[0] - m->window) - w->origin);
    s[LTS_SOIL_WAY] = (float)w->way;
    s[LTS_SOIL_SPEED] = (float)fmin(w->speed, fastest);
    for (int i = 0; i < LTS_SOIL_MEMORIES; ++i) {
      float *of = s + LTS_SOIL_MEMORY + LTS_SOIL_MOTIONS * i;
      for (int k = 0; k < 3; ++k) of[k] = (float)w->memory[i][k];
      of[3] = (float)fmin(w->memory[i][3], fastest);
    }
    memcpy(s + LTS_SOIL_OWN, soil->own, (size_t)m->n_own * sizeof *s);
    for (int i = 0; i < 2; ++i) {
      const int k = of_soil[i], judged = LTS_SOIL_JUDGED_OWN + k;
      const double reach = 0.5 * (high[judged] - low[judged]);
      s[LTS_SOIL_OWN + k] = (float)fmin(fmax(soil->own[k], low[judged] - reach), high[judged] + reach);
    }
    const double cut = m->spacing * sum_of_cuts(p->surface + LTS_SOIL_ROW(soil, j),
                                                p->profile + LTS_SOIL_ROW(soil, j), 0, m->n_bin);
    s[LTS_SOIL_OF_PASSAGE(m, CARRIED)] = (float)(w->dropped[j] + cut + owed); /* (19) */
    s[LTS_SOIL_OF_PASSAGE(m, BELOW)] = (float)fmin(fmax(below, 0.0), m->below_tool);
    s[LTS_SOIL_OF_PASSAGE(m, AHEAD)] = (float)fmin(ahead, m->ahead);
    s[LTS_SOIL_OF_PASSAGE(m, LAYER)] = (float)layer(soil, p, j);
    s[LTS_SOIL_OF_PASSAGE(m, BEHIND)] = (float)fmin(behind, m->ahead);
    s[LTS_SOIL_OF_PASSAGE(m, PRESSED)] = (float)pressed[j];
  }
}

void lts_soil_make_frame(lts_soil *soil, const lts_passage *p, int all) {
  const lts_soil_model *m = soil->model;
  const int is_seen = soil->seen == p;
  if (is_seen && (soil->sees_all || !all)) return;
  if (!is_seen) see_scalars(soil, p);
  const double middle = (p->s.pose[0] - p->s.origin) / m->spacing + m->n_behind;
  const double reach = m->see_reach / m->spacing;
  const int low = all ? 0 : (int)fmax(middle - reach, 0.0);
  const int high = all ? m->n_bin : (int)fmin(middle + reach + 2.0, (double)m->n_bin);
  for (int j = 0; j < p->s.n_strip; ++j) {
    const size_t row = LTS_SOIL_ROW(soil, j);
    const double *surface = p->surface + row, *profile = p->profile + row;
    float *cut = soil->bins[LTS_SOIL_CUT] + row, *up = soil->bins[LTS_SOIL_SURFACE] + row;
    for (int k = low; k < high; ++k) {
      cut[k] = (float)(surface[k] - profile[k]); /* (3) */
      up[k] = (float)(surface[k] - p->s.level);
    }
    if (all) see_past(soil, p, row);
  }
  soil->seen = p;
  soil->sees_all = all;
}
