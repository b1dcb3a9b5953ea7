/* Soil that a bucket holds, takes up and pours. Twin of `soil_field/payload.py` and of what `passage.py` does with
 * it; lengths of the field. */
#include <math.h>

#include "lts_soil_internal.h"

#define MOST 40 /* corners of a polygon that two lines have cut */

/* The part of a polygon below the line through a point that falls by `fall` per way; how many corners it has. */
static int cut(const double (*points)[2], int n, const double through[2], double fall, double (*out)[2]) {
  int kept = 0;
  for (int i = 0; i < n; ++i) {
    const double *p = points[i], *q = points[i + 1 < n ? i + 1 : 0];
    const double a = p[1] - through[1] + fall * (p[0] - through[0]);
    const double b = q[1] - through[1] + fall * (q[0] - through[0]);
    if (a <= 0.0) {
      out[kept][0] = p[0];
      out[kept++][1] = p[1];
    }
    if ((a <= 0.0) == (b <= 0.0)) continue;
    out[kept][0] = p[0] + a / (a - b) * (q[0] - p[0]);
    out[kept++][1] = p[1] + a / (a - b) * (q[1] - p[1]);
  }
  return kept;
}

/* Twin of `payload.Shape`. */
void lts_soil_fit_bucket(lts_soil *soil) {
  enum { N = LTS_SOIL_INSIDE };
  const double height = soil->tool.length / soil->scale, shell = soil->model->shell;
  const double under = soil->tool.floor_share * height;
  const double floor = sqrt(fmax(under * under - shell * shell, 0.0));
  const double slope = soil->tool.floor_deg * LTS_PI / 180.0 + atan2(shell, floor);
  const double sine = sin(slope), cosine = cos(slope);
  const double radius = fmax(height - shell - floor * sine, 0.0) / (1.0 + cosine);
  soil->inner_slope = slope;
  for (int i = 0; i < N - 2; ++i) {
    const double turn = slope - 0.5 * LTS_PI + soil->model->arc * i / (N - 3);
    soil->inside[i + 1][0] = -(floor * cosine + radius * (cos(turn) - sine));
    soil->inside[i + 1][1] = floor * sine + radius * (sin(turn) + cosine);
    soil->reach = fmax(soil->reach, -soil->inside[i + 1][0]);
  }
  const double *rim = soil->inside[N - 2];
  soil->inside[N - 1][0] = rim[0] / 2.0 + rim[1];
  soil->inside[N - 1][1] = rim[1] / 2.0 - rim[0];
}

static double lean_of(const lts_passage *p) { return p->s.pose[2] + atan(p->s.place.grade); }

/* Twin of `payload.Room`. */
typedef struct {
  double area, middle, holds;
} lts_room;

static lts_room room_of(const lts_soil *soil, const lts_passage *p) {
  const lts_soil_model *m = soil->model;
  double points[LTS_SOIL_INSIDE][2], once[MOST][2], below[MOST][2], twice = 0.0, moment = 0.0;
  lts_room room = {0.0, 0.0, 0.0};
  if (m->kind != LTS_SOIL_BLADE || soil->tool.bucket == 0.0 || !soil->writes) return room;
  const double lean = lean_of(p);
  const double sine = sin(lean), cosine = cos(lean), friction = tan(soil->terrain->friction_angle_deg * LTS_PI / 180.0);
  for (int i = 0; i < LTS_SOIL_INSIDE; ++i) {
    const double u = soil->inside[i][0], y = soil->inside[i][1];
    points[i][0] = cosine * u - sine * y;
    points[i][1] = sine * u + cosine * y;
  }
  const double *rim = points[LTS_SOIL_INSIDE - 2], way = rim[0] > points[0][0] ? 1.0 : -1.0;
  int n = cut((const double (*)[2])points, LTS_SOIL_INSIDE, points[0], -way * friction, once);
  n = cut((const double (*)[2])once, n, rim, way * friction, below);
  for (int i = 0; i < n; ++i) {
    const double *a = below[i], *b = below[i + 1 < n ? i + 1 : 0], sides = a[0] * b[1] - a[1] * b[0];
    twice += sides;
    moment += sides * (a[0] + b[0]);
  }
  if (twice != 0.0) room.middle = moment / twice / 3.0;
  room.holds = fmin(fmax((m->slips - (soil->inner_slope - lean)) / m->slips_out + 1.0, 0.0), 1.0);
  room.area = room.holds * fabs(twice) / 2.0;
  return room;
}

/* Mean cut of the strips under the tool at u from the origin. */
static double cut_at(const lts_soil *soil, const lts_passage *p, double u) {
  const lts_soil_model *m = soil->model;
  const double at = fmin(fmax(u / m->spacing + m->n_behind, 0.0), m->n_bin - 1.0);
  const int k = at < m->n_bin - 1.0 ? (int)at : m->n_bin - 2;
  int first;
  const int count = lts_soil_under(soil, p, &first);
  double low = 0.0, high = 0.0;
  for (int j = first; j < first + count; ++j) {
    const size_t i = LTS_SOIL_ROW(soil, j) + (size_t)k;
    low += p->surface[i] - p->profile[i];
    high += p->surface[i + 1] - p->profile[i + 1];
  }
  return (low + (at - k) * (high - low)) / count;
}

enum { N_ALONG = 6, N_ACROSS = 5 };

typedef struct {
  const lts_soil_model *model;
  double tip, inside, half;
} floor_places;

static void place_over_floor(const void *of, size_t k, double out[3]) {
  const floor_places *over = of;
  out[0] = over->tip - over->inside * over->model->taken_along[k / N_ACROSS];
  out[1] = 0.0;
  out[2] = over->half * over->model->taken_across[k % N_ACROSS];
}

/* What is taken up into some room. */
static double scooped(lts_soil *soil, const lts_passage *p, double room) {
  const floor_places over = {soil->model, p->s.pose[0] - p->s.origin, soil->reach, soil->width / 2.0};
  float risen[N_ALONG * N_ACROSS];
  double sum = 0.0;
  lts_soil_find(soil, p, 1, N_ALONG * N_ACROSS, place_over_floor, &over, risen);
  for (size_t k = 0; k < N_ALONG * N_ACROSS; ++k) {
    double at[3];
    place_over_floor(&over, k, at);
    sum += fmax((double)risen[k] + cut_at(soil, p, at[0]), 0.0);
  }
  const double *taken = soil->model->taken, *curled = soil->model->curled;
  const double fall = lean_of(p) - soil->inner_slope;
  const double curl = fmin(fmax((fall - curled[0]) / (curled[1] - curled[0]), 0.0), 1.0);
  const double kept = taken[0] + (taken[1] - taken[0]) * curl;
  return fmin(fmax(room - p->s.payload, 0.0), kept * over.inside * sum / (N_ALONG * N_ACROSS));
}

double lts_soil_scooped(lts_soil *soil, const lts_passage *p) {
  const double room = room_of(soil, p).area;
  return room > 0.0 ? scooped(soil, p, room) : 0.0;
}

lts_held lts_soil_held(lts_soil *soil, const lts_passage *p) {
  const lts_held none = {0.0, 0.0, 0.0, 0.0};
  const lts_room room = room_of(soil, p);
  lts_held held = {fmin(p->s.payload + p->s.taken, room.area), 0.0, room.middle, p->s.lifted ? room.holds : 0.0};
  if (!(room.holds > 0.0)) return none;
  held.weighs = held.area;
  if (p->s.lifted || !lts_soil_has_cut(soil, p)) return held;
  const double share = fmin(fmax(lts_soil_over(soil, p, p->s.pose) / soil->model->lifted, 0.0), 1.0);
  if (share > 0.0) held.weighs += share * scooped(soil, p, room.area);
  held.replaces = room.holds * share;
  return held;
}

void lts_soil_give_and_take(lts_soil *soil, lts_passage *p, int keeps) {
  const lts_soil_model *m = soil->model;
  const lts_terrain *t = soil->terrain;
  lts_cells *c = &soil->cells[p->s.cells];
  const double cell = t->cell[0] * t->cell[1] / (soil->scale * soil->scale), half = soil->width / 2.0;
  double found = 0.0;
  if (!(p->s.taken > 0.0 || p->s.payload > 0.0)) return;
  if (p->s.taken > 0.0) {
    double share = 0.0;
    for (int pass = 0; pass < 2; ++pass) { /* first how much there is */
      for (int32_t k = 0; k < c->n; ++k) {
        const double ahead = c->u[k] - p->s.pose[0];
        if (!(fabs(c->across[k]) <= half && ahead <= 0.0 && ahead > -soil->reach)) continue;
        const double deep = cut_at(soil, p, c->u[k] - p->s.origin) / p->s.place.cosine;
        const double over = fmax((c->left[k] - c->before[k]) / soil->scale + deep, 0.0);
        if (!pass) {
          found += cell * over / soil->width;
          continue;
        }
        const double h = c->left[k] - soil->scale * share * over;
        c->left[k] = h;
        t->heights[c->number[k]] = h < t->floor ? t->floor : h;
      }
      share = fmin(p->s.taken / fmax(found, 1e-12), 1.0);
    }
    p->s.left_behind += share * found * soil->width;
    p->s.payload += share * found;
    p->s.taken = 0.0;
  }
  const double excess = p->s.payload - (keeps ? room_of(soil, p).area : 0.0);
  if (!(excess > 0.0)) return;
  p->s.payload -= excess;
  int32_t n = 0;
  for (int32_t k = 0; k < c->n; ++k) {
    const double ahead = c->u[k] - p->s.pose[0];
    if (fabs(c->across[k]) <= half && fabs(ahead - m->falls_ahead) <= m->falls_apart) soil->gone[n++] = c->number[k];
  }
  for (int32_t k = 0; k < n; ++k) t->heights[soil->gone[k]] += excess * soil->width / (n * cell) * soil->scale;
  lts_soil_settle(soil, soil->gone, n, NULL);
}
