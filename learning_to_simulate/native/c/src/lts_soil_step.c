/* A tool on a terrain, frame by frame: forces, how far they can be trusted, and what is refused. Twin of
 * `TfEngine` (`soil_field/engine.py`) and of `SoilField.judged`. */
#include <math.h>
#include <string.h>

#include "lts_soil_internal.h"

/* ---- status ---- */

#define N_GROUND 8

/* Depth of the tool, how low, high and uneven the ground about it is, how near a wall, its speed along the way,
 * how far it has gone back, and how near a wall is behind it; whether the tool may touch the ground. */
static int find_ground(const lts_soil *soil, const lts_passage *p, double area, double found[N_GROUND]) {
  const lts_soil_model *m = soil->model;
  const int n_strip = p->s.n_strip;
  const float *surface = soil->bins[LTS_SOIL_SURFACE], *s = soil->scalars[0];
  const double tip = s[LTS_SOIL_TIP], bottom = (double)s[LTS_SOIL_HEIGHT] - (double)s[m->radius];
  const double middle = tip / m->spacing + m->n_behind, reach = m->judged_near / m->spacing;
  const int begin = (int)fmax(middle - reach - 1.0, 0.0);
  const int end = (int)fmin(middle + reach + 2.0, (double)m->n_bin);
  double sum = 0.0;
  float least = HUGE_VALF, most = -HUGE_VALF, uneven = 0.0f;
  int n_here = 0;
  for (int k = begin; k < end; ++k) {
    const double away = fabs(lts_soil_offset(m, k) - tip);
    if (!(away < m->judged_near)) continue;
    float total = 0.0f;
    for (int j = 0; j < n_strip; ++j) total += surface[LTS_SOIL_ROW(soil, j) + (size_t)k];
    const float under = total / (float)n_strip;
    const int is_here = away < m->judged_here;
    if (is_here) sum += under;
    n_here += is_here;
    for (int j = 0; j < n_strip; ++j) {
      const size_t i = LTS_SOIL_ROW(soil, j) + (size_t)k;
      const float off = fabsf(surface[i] - under);
      least = surface[i] < least ? surface[i] : least;
      most = surface[i] > most ? surface[i] : most;
      uneven = off > uneven ? off : uneven;
    }
  }
  const double level = sum / n_here;
  found[0] = level - bottom;
  found[1] = least - level;
  found[2] = most - level;
  found[3] = uneven;
  found[4] = m->ahead - (double)s[LTS_SOIL_OF_PASSAGE(m, AHEAD)];
  found[5] = fabs((double)s[LTS_SOIL_MEMORY]) * (double)(float)p->s.speed;
  float foremost = s[LTS_SOIL_FOREMOST];
  for (int j = 1; j < n_strip; ++j) foremost = fmaxf(foremost, soil->scalars[j][LTS_SOIL_FOREMOST]);
  found[6] = fmin(fmax(foremost - s[LTS_SOIL_TIP], 0.0), soil->model->backs);
  found[7] = m->ahead - (double)s[LTS_SOIL_OF_PASSAGE(m, BEHIND)];
  return lts_soil_lowest_part(soil) < level + (double)m->above + (double)m->heap * sqrt(fmax(area, 0.0));
}

/* `Passage.crossfall`: weighted sums over the cells before the tool, of which few lie under it. */
static double crossfall_of(const lts_soil *soil, const lts_passage *p) {
  const lts_soil_model *m = soil->model;
  const lts_terrain *t = soil->terrain;
  const lts_cells *c = &soil->cells[p->s.cells];
  const double cell = fmax(t->cell[0], t->cell[1]) / soil->scale, width = soil->width + cell;
  const double fall = p->s.place.grade * p->s.place.cosine; /* along the way */
  double sum = 0.0, z = 0.0, h = 0.0, zz = 0.0, zh = 0.0;
  if (m->n_column > 1) return 0.0;
  for (int32_t k = 0; k < c->n; ++k) {
    const double part = 2.0 * c->across[k] / width, inside = 1.0 - part * part;
    if (!(inside > 0.0 && fabs(c->u[k] - p->s.pose[0]) <= m->crossed + cell)) continue;
    const double weight = inside * inside, at = weight * c->across[k];
    const double height = c->before[k] / soil->scale - fall * c->u[k];
    sum += weight;
    z += at;
    h += weight * height;
    zz += at * c->across[k];
    zh += at * height;
  }
  sum = fmax(sum, 1e-12);
  return fabs(zh - z / sum * h) / fmax(zz - z / sum * z, 1e-6 * sum) * soil->width;
}

/* What no network sees: `CONDITIONS` of field.py. */
static void find_conditions(const lts_soil *soil, const lts_passage *p, const lts_pose *pose,
                            double found[LTS_SOIL_CONDITIONS]) {
  const lts_terrain *t = soil->terrain;
  const double *at = pose->position, half = soil->tool.width / 2.0;
  const double *across = p->s.place.across, back[2] = {-across[0], -across[1]}, here[2] = {at[0], at[2]};
  const double beside = fmin(lts_terrain_wall(t, here, across), lts_terrain_wall(t, here, back)) - half;
  double turns[3], local[3], level, beyond = 0.0, near = 0.0;
  lts_place_turns(&p->s.place, pose, turns);
  lts_place_local(&p->s.place, at, local);
  for (int i = 0; i < 4; ++i) { /* both ends, x and z */
    const int axis = i / 2;
    const double end = at[2 * axis] + (i % 2 ? half : -half) * across[axis] - t->corner[axis];
    beyond = fmax(beyond, fmax(-end, end - t->cell[axis] * t->n[axis]));
  }
  const double over = at[1] - soil->tool.radius - t->floor;
  for (const lts_soil *other = t->first; other; other = other->next) {
    if (other == soil || !other->started || !other->writes) continue;
    const double away = hypot(other->pose.position[0] - at[0], other->pose.position[2] - at[2]);
    near = fmax(near, half + other->tool.width / 2.0 + soil->scale * soil->model->apart - away);
  }
  found[0] = turns[1];
  found[1] = turns[2];
  found[2] = local[2] / soil->scale;
  found[3] = beyond / soil->scale;
  found[4] = fmax(soil->model->least_soil - over / soil->scale, 0.0);
  found[5] = near / soil->scale;
  found[6] = fmax(t->cell[0], t->cell[1]) / soil->scale;
  found[7] = crossfall_of(soil, p);
  found[8] = lts_soil_line(soil, p, &level);
  const double whole = lts_soil_whole_grade(&p->s.place, found[8]);
  if (fabs(whole) > soil->model->steep) found[8] = whole;
  const int is_blade = soil->model->kind == LTS_SOIL_BLADE;
  const double *done = p->s.memory[LTS_SOIL_MEMORIES - 1], product = done[0] * done[2];
  const double slip = product < 0.0 ? product / hypot(done[0], done[2]) : fabs(done[2]);
  found[9] = is_blade ? done[2] : slip;
  found[10] = is_blade ? (soil->tool.bucket != 0.0 ? soil->model->curl - p->s.pose[2] : p->s.pose[2]) : 0.0;
  found[11] = fmax(soil->model->wall_beside - beside / soil->scale, 0.0);
  found[12] = 0.0;
  if (!is_blade || soil->tool.bucket == 0.0 || soil->tool.floor_deg * LTS_PI / 180.0 - p->s.pose[2] >= 0.0) return;
  for (int j = 0; j < p->s.n_strip; ++j) {
    found[12] = fmax(found[12], (double)soil->scalars[j][LTS_SOIL_OF_PASSAGE(soil->model, PRESSED)]);
  }
}

/* Scalars, ground and conditions [n_judged]; in the air all is free but what the tool is, and where it holds soil its
 * lean and roll. bears: whether soil acts on the tool, negative where that is not known. */
static void find_judged(const lts_soil *soil, const lts_passage *p, const lts_pose *pose, int bears, int holds,
                        double *values) {
  const lts_soil_model *m = soil->model;
  enum { N_PATH = LTS_SOIL_JUDGED_OWN };
  const int path[N_PATH] = {LTS_SOIL_LEAN, LTS_SOIL_AREA, LTS_SOIL_OF_PASSAGE(m, CARRIED), LTS_SOIL_SPEED,
                            LTS_SOIL_OF_PASSAGE(m, PRESSED)};
  for (int i = 0; i < m->n_named; ++i) {
    const int column = i < N_PATH ? path[i] : LTS_SOIL_OWN + i - N_PATH;
    float most = soil->scalars[0][column];
    for (int j = 1; j < p->s.n_strip; ++j) {
      if (soil->scalars[j][column] > most) most = soil->scalars[j][column];
    }
    values[i] = most;
  }
  /* Networks see at most what was taught of these. */
  values[LTS_SOIL_JUDGED_SPEED] = (float)p->s.speed;
  values[N_PATH + LTS_SOIL_FRICTION] = soil->own[LTS_SOIL_FRICTION];
  values[N_PATH + LTS_SOIL_STRESS(m)] = soil->own[LTS_SOIL_STRESS(m)];
  const int touches = find_ground(soil, p, fmax(values[1], values[2]), values + m->n_named);
  if (bears < 0 ? touches : bears) {
    find_conditions(soil, p, pose, values + m->n_named + N_GROUND);
    return;
  }
  const double lean = values[0];
  for (int i = 0; i < m->n_judged; ++i) {
    if (i < N_PATH || i >= m->n_named) values[i] = m->middle[i];
  }
  if (!holds) return;
  values[0] = lean;
  double turns[3];
  lts_place_turns(&p->s.place, pose, turns);
  values[m->n_named + N_GROUND + 1] = turns[2];
}

/* Bits of all that is outside, and the first of them; or of what is not finite. */
static int judge(const lts_soil *soil, const lts_passage *p, const lts_pose *pose, int bears, int holds,
                 int is_finite, int frame, lts_judgement *found) {
  const lts_soil_model *m = soil->model;
  const int n = m->n_judged;
  double values[LTS_SOIL_SCALARS];
  *found = lts_well;
  if (!is_finite) {
    const lts_judgement none = {LTS_NON_FINITE, frame, -1, -1, NAN, -HUGE_VAL, HUGE_VAL};
    *found = none;
    return LTS_NON_FINITE;
  }
  find_judged(soil, p, pose, bears, holds, values);
  for (int i = 0; i < n; ++i) {
    const double *limits = m->limits + i;
    if (values[i] >= limits[0] && values[i] <= limits[n]) continue;
    if (found->status) {
      found->status |= m->bits[i];
      continue;
    }
    const lts_judgement first = {m->bits[i], frame, -1, i, values[i], limits[2 * n], limits[3 * n]};
    *found = first;
  }
  return found->status;
}

static int rank(const lts_judgement *j) { return j->status & LTS_NON_FINITE ? 2 : j->status != 0; }

int lts_soil_reason(const lts_soil *soil, const lts_judgement *judgement, char *text, size_t size) {
  LTS_TRY(lts_check(soil));
  if (!judgement || !text) return LTS_ERROR_NULL;
  if (judgement->axis >= soil->model->n_judged) return LTS_ERROR_VALUE;
  char name[LTS_LONGEST_NAME] = "a prediction";
  if (judgement->axis >= 0) lts_name_of(soil->model->judged_names, judgement->axis, name, sizeof name);
  lts_say(judgement, name, text, size);
  return judgement->status;
}

/* ---- frames ---- */

/* The frame of a passage whose tool is at a pose. */
static void answer(lts_soil *soil, lts_passage *p, const lts_pose *pose, const lts_judgement *before,
                   int passage, lts_soil_result *out) {
  const int members = soil->members;
  double mean[6];
  const int loaded = lts_soil_find_loads(soil, p, members, soil->loads);
  const lts_held held = lts_soil_held(soil, p);
  const double share = loaded ? lts_soil_contact(soil, p) * (1.0 - held.replaces) : 1.0;
  int is_finite = 1;
  for (int i = 0; i < 6; ++i) {
    double sum = 0.0, square = 0.0;
    for (int k = 0; k < members; ++k) sum += soil->loads[6 * k + i] * soil->units[i] * share;
    mean[i] = sum / members;
    for (int k = 0; k < members; ++k) {
      const double away = soil->loads[6 * k + i] * soil->units[i] * share - mean[i];
      square += away * away;
    }
    out->spread[i] = sqrt(square / members);
    is_finite &= isfinite(mean[i]) != 0;
  }
  const double *weights = soil->model->bound;
  const double apart = lts_length(out->spread, 3), size = lts_length(mean, 3);
  out->bound = members < soil->model->n_member || weights[0] < 0.0
                   ? NAN
                   : weights[0] * soil->units[0] + weights[1] * apart + weights[2] * size;
  lts_place_unlaid(&p->s.place, mean, out->force);
  lts_place_unlaid(&p->s.place, mean + 3, out->torque);
  /* A bucket that is about to take soil up stays with the soil that it has cut. */
  p->s.bears = held.weighs > held.area;
  for (int i = 0; i < 6; ++i) p->s.bears |= mean[i] != 0.0;
  /* A blade on its head may touch soil without a load. */
  judge(soil, p, pose, loaded ? share > 0.0 : -1, held.area > 0.0, is_finite, soil->frame, &out->now);
  const double weight = soil->model->standard_density * soil->model->standard_gravity * held.weighs * soil->width;
  out->force[1] -= weight * soil->units[0];
  out->torque[0] -= weight * held.middle * soil->units[3] * p->s.place.across[0];
  out->torque[2] -= weight * held.middle * soil->units[3] * p->s.place.across[1];
  out->payload = held.area * soil->width * soil->scale * soil->scale * soil->scale;
  out->worst = before && rank(before) >= rank(&out->now) ? *before : out->now;
  out->status = out->worst.status;
  out->frame = soil->frame;
  out->passage = passage;
  out->unused = 0;
  out->pose = *pose;
}

static int is_under_floor(const lts_soil *soil, const lts_pose *pose) {
  return !(pose->position[1] - soil->tool.radius >= soil->terrain->floor);
}

/* Begins a passage in the other place, with the cells that are not in use; in the plane of a place, or (null) of the
 * pose. */
static int begin_other(lts_soil *soil, const lts_pose *pose, int set_down, const lts_place *place,
                       lts_passage **out) {
  lts_passage *p = &soil->passage[!soil->now];
  soil->seen = NULL;
  p->s.cells = soil->passage[soil->now].s.cells;
  LTS_TRY(lts_soil_begin(soil, p, pose, set_down, place));
  p->s.stale = set_down;
  if (soil->started && soil->writes) p->s.payload = soil->passage[soil->now].s.payload;
  *out = p;
  /* Of cells that are in sight it knows nothing yet. */
  lts_cells *kept = &soil->cells[p->s.cells];
  const int32_t n = kept->n;
  kept->n = 0;
  lts_soil_look_around(soil, p);
  kept->n = n;
  return LTS_OK;
}

/* Ends a passage: its soil comes to rest. */
static void finish(lts_soil *soil, const lts_passage *p) {
  if (!soil->started || !soil->writes) return;
  lts_soil_write(soil);
  const lts_cells *c = &soil->cells[p->s.cells];
  lts_soil_settle(soil, c->number, c->n, NULL);
}

static int start(lts_soil *soil, const lts_pose *pose, int set_down, int writes, lts_pose *unit) {
  LTS_TRY(lts_check(soil));
  if (!pose) return LTS_ERROR_NULL;
  lts_passage *p;
  if (!lts_soil_unit_pose(pose, unit)) return LTS_ERROR_VALUE;
  if (writes && is_under_floor(soil, unit)) return LTS_ERROR_PLACE;
  lts_place place;
  if (!lts_place_of(unit, &place)) return LTS_ERROR_VALUE;
  if (soil->started && soil->writes) lts_soil_give_and_take(soil, &soil->passage[soil->now], 0);
  finish(soil, &soil->passage[soil->now]);
  const int was_started = soil->started;
  soil->started = 0; /* what has come to rest is not written again */
  const int begun = begin_other(soil, unit, set_down, NULL, &p);
  soil->started = was_started;
  LTS_TRY(begun);
  soil->now = !soil->now;
  soil->started = 1;
  soil->writes = writes;
  soil->frame = 0;
  soil->pose = *unit;
  return LTS_OK;
}

int lts_soil_start(lts_soil *soil, const lts_pose *pose, lts_soil_result *result) {
  lts_pose unit;
  LTS_TRY(start(soil, pose, 1, 1, &unit));
  answer(soil, &soil->passage[soil->now], &unit, NULL, 0, &soil->result);
  if (result) *result = soil->result;
  return soil->result.status;
}

/* Whether the tool may go to a pose; `unit` is the pose with a quaternion of length 1. */
static int check_step(const lts_soil *soil, const lts_pose *pose, double dt, lts_pose *unit) {
  LTS_TRY(lts_soil_check_started(soil));
  if (!pose) return LTS_ERROR_NULL;
  if (!soil->writes) return LTS_ERROR_CALL; /* an anchor has no loads */
  const lts_soil_model *m = soil->model;
  if (!lts_soil_unit_pose(pose, unit) || !(dt > 0.0 && isfinite(dt))) return LTS_ERROR_VALUE;
  double way[3], cosine = 0.0;
  for (int i = 0; i < 3; ++i) way[i] = unit->position[i] - soil->pose.position[i];
  for (int i = 0; i < 4; ++i) cosine += unit->rotation[i] * soil->pose.rotation[i];
  const double turn = 2.0 * acos(fmin(fabs(cosine), 1.0));
  if (!(lts_length(way, 3) / dt <= m->fastest && turn / dt <= m->fastest_turn)) return LTS_ERROR_JUMP;
  return is_under_floor(soil, unit) ? LTS_ERROR_PLACE : LTS_OK;
}

/* Whether a tool is in the air and has left the plane of its passage, or is over what it has cut. */
static int is_away(const lts_soil *soil, const lts_pose *pose) {
  const lts_place *place = &soil->passage[soil->now].s.place;
  double turns[3], local[3];
  if (soil->passage[soil->now].s.bears) return 0;
  lts_place_turns(place, pose, turns);
  lts_place_local(place, pose->position, local);
  if (lts_soil_is_over(soil, &soil->passage[soil->now])) return 1;
  return fabs(turns[1]) > soil->model->turned || fabs(local[2] / soil->scale) > soil->model->moved;
}

/* There a tool begins a new passage, where that is in the air too. Says whether it does. */
static int turns_away(lts_soil *soil, const lts_pose *pose, lts_passage **fresh) {
  if (!is_away(soil, pose)) return 0;
  LTS_TRY(begin_other(soil, pose, 1, NULL, fresh));
  return !lts_soil_find_loads(soil, *fresh, 1, soil->loads);
}

/* `Passage.renewed`, in the other place; its cells that are gone are those that come out of sight. */
static int renew(lts_soil *soil, lts_passage **out) {
  const lts_way *old = &soil->passage[soil->now].s;
  lts_place place;
  lts_soil_lay(soil, &soil->passage[soil->now], soil->model->flat, &place);
  LTS_TRY(begin_other(soil, &soil->pose, 0, &place, out));
  lts_passage *p = *out;
  /* What it remembers is seen from the new ground. */
  const double change = atan(place.grade) - atan(old->place.grade), on = cos(change), off = sin(change);
  for (int i = 0; i < LTS_SOIL_MEMORIES; ++i) {
    const double *of = old->memory[i];
    const double seen[LTS_SOIL_MOTIONS] = {on * of[0] + off * of[1], on * of[1] - off * of[0], of[2], of[3]};
    memcpy(p->s.memory[i], seen, sizeof seen);
  }
  p->s.speed = old->speed;
  const lts_cells *left = &soil->cells[!p->s.cells], *c = &soil->cells[p->s.cells];
  for (int32_t k = 0, i = 0; k < left->n; ++k) {
    while (i < c->n && c->number[i] < left->number[k]) ++i;
    if (i == c->n || c->number[i] != left->number[k]) soil->gone[p->s.n_gone++] = left->number[k];
  }
  return LTS_OK;
}

/* What comes before a step: whether it begins the new passage `fresh`. */
static int prepare(lts_soil *soil, const lts_pose *pose, double dt, lts_pose *unit, lts_passage **fresh) {
  LTS_TRY(check_step(soil, pose, dt, unit));
  LTS_TRY(lts_soil_meet_others(soil));
  return turns_away(soil, unit, fresh);
}

int lts_soil_step(lts_soil *soil, const lts_pose *pose, double dt, lts_soil_result *result) {
  lts_pose unit;
  lts_passage *p = NULL;
  const int away = prepare(soil, pose, dt, &unit, &p);
  LTS_TRY(away);
  if (away) {
    finish(soil, &soil->passage[soil->now]);
    soil->now = !soil->now;
  } else {
    if (lts_soil_is_due(soil, &soil->passage[soil->now])) {
      double coming[3], change[3];
      LTS_TRY(renew(soil, &p));
      LTS_TRY(lts_soil_reach(soil, p, &unit, coming, change)); /* before anything changes */
      soil->now = !soil->now;
      lts_soil_settle(soil, soil->gone, p->s.n_gone, p);
    }
    p = &soil->passage[soil->now];
    LTS_TRY(lts_soil_go(soil, p, &unit, dt));
  }
  const lts_judgement before = soil->result.worst;
  answer(soil, p, &unit, &before, soil->result.passage + away, &soil->result);
  soil->pose = unit;
  if (soil->frame < INT32_MAX) ++soil->frame;
  lts_soil_settle(soil, soil->gone, p->s.n_gone, p);
  lts_soil_give_and_take(soil, p, 1);
  if (result) *result = soil->result;
  return soil->result.status;
}

int lts_soil_propose(lts_soil *soil, const lts_pose *pose, double dt, lts_soil_result *result) {
  lts_pose unit;
  lts_passage *p = NULL;
  const int away = prepare(soil, pose, dt, &unit, &p);
  LTS_TRY(away);
  if (!away) {
    p = &soil->passage[!soil->now];
    if (lts_soil_is_due(soil, &soil->passage[soil->now])) LTS_TRY(renew(soil, &p));
    else lts_soil_copy(soil, p, &soil->passage[soil->now]);
    LTS_TRY(lts_soil_go(soil, p, &unit, dt));
  }
  lts_soil_result found;
  answer(soil, p, &unit, &soil->result.worst, soil->result.passage + away, &found);
  soil->seen = NULL; /* the next trial takes the same place */
  if (result) *result = found;
  return found.status;
}

int lts_soil_tangent(lts_soil *soil, const lts_pose *pose, double dt, const double *direction, double reach,
                     double *out) {
  LTS_TRY(lts_soil_check_started(soil));
  if (!direction || !out) return LTS_ERROR_NULL;
  const lts_pose from = pose ? *pose : soil->pose;
  lts_pose unit, there;
  lts_twist way;
  double shift = 0.0, turn = 0.0;
  if (!lts_soil_unit_pose(&from, &unit)) return LTS_ERROR_VALUE;
  for (int i = 0; i < 3; ++i) {
    way.linear[i] = direction[i];
    way.angular[i] = direction[3 + i];
    shift = hypot(shift, direction[i]);
    turn = hypot(turn, direction[3 + i]);
  }
  const double step = reach / (shift + 0.1 * turn);
  if (!(step > 0.0 && isfinite(step))) return LTS_ERROR_VALUE;
  lts_soil_result ends[2];
  for (int end = 0; end < 2; ++end) {
    lts_moved_pose(&unit, &way, end ? -step : step, &there);
    LTS_TRY(lts_soil_propose(soil, &there, dt, &ends[end]));
  }
  for (int i = 0; i < 3; ++i) {
    out[i] = (ends[0].force[i] - ends[1].force[i]) / (2.0 * step);
    out[3 + i] = (ends[0].torque[i] - ends[1].torque[i]) / (2.0 * step);
  }
  return LTS_OK;
}

int lts_soil_newest(const lts_soil *soil, lts_soil_result *result) {
  LTS_TRY(lts_soil_check_started(soil));
  if (!result) return LTS_ERROR_NULL;
  if (!soil->writes) return LTS_ERROR_CALL;
  *result = soil->result;
  return result->status;
}

int lts_soil_place(const lts_soil *soil, double *out) {
  LTS_TRY(lts_soil_check_started(soil));
  if (!out) return LTS_ERROR_NULL;
  const lts_place *place = &soil->passage[soil->now].s.place;
  const double *of[3] = {place->origin, place->along, place->across};
  for (int i = 0; i < 3; ++i) {
    out[3 * i] = of[i][0];
    out[3 * i + 1] = 0.0;
    out[3 * i + 2] = of[i][1];
  }
  return LTS_OK;
}

/* ---- particles ---- */

int lts_soil_anchor(lts_soil *soil, const lts_pose *pose, int set_down) {
  lts_pose unit;
  return start(soil, pose, set_down != 0, 0, &unit);
}

int lts_soil_reads(const lts_soil *soil, const lts_pose *pose) {
  LTS_TRY(lts_soil_check_started(soil));
  if (!pose) return LTS_ERROR_NULL;
  lts_pose unit;
  if (!lts_soil_unit_pose(pose, &unit)) return LTS_ERROR_VALUE;
  const lts_way *way = &soil->passage[soil->now].s;
  double local[3];
  lts_place_local(&way->place, unit.position, local);
  lts_place_laid(&way->place, local, local);
  if (soil->writes && (is_away(soil, &unit) || lts_soil_is_due(soil, &soil->passage[soil->now]))) return 1;
  return lts_soil_followed(soil->model, way->origin, local[0] / soil->scale) != way->origin;
}

int lts_soil_follow(lts_soil *soil, const lts_pose *pose, double dt) {
  LTS_TRY(lts_soil_check_started(soil));
  if (!pose) return LTS_ERROR_NULL;
  lts_pose unit;
  if (soil->writes) return LTS_ERROR_CALL;
  if (!lts_soil_unit_pose(pose, &unit) || !(dt > 0.0 && isfinite(dt))) return LTS_ERROR_VALUE;
  LTS_TRY(lts_soil_go(soil, &soil->passage[soil->now], &unit, dt));
  soil->pose = unit;
  return LTS_OK;
}

typedef struct {
  const lts_soil *soil;
  const double *points;
} world_points;

static void place_of_point(const void *of, size_t i, double out[3]) {
  const world_points *w = of;
  const lts_passage *p = &w->soil->passage[w->soil->now];
  const double scale = w->soil->scale;
  lts_place_local(&p->s.place, w->points + 3 * i, out);
  lts_place_laid(&p->s.place, out, out);
  out[0] = out[0] / scale - p->s.origin;
  out[1] = out[1] / scale - p->s.level;
  out[2] /= scale;
}

#define AT_ONCE 1024

int lts_soil_displacement(lts_soil *soil, const double *points, size_t n, double *out) {
  LTS_TRY(lts_soil_check_started(soil));
  if (n && (!points || !out)) return LTS_ERROR_NULL;
  const lts_passage *p = &soil->passage[soil->now];
  float moved[3 * AT_ONCE];
  for (size_t done = 0; done < n; done += AT_ONCE) {
    const size_t now = n - done < AT_ONCE ? n - done : AT_ONCE;
    const world_points of = {soil, points + 3 * done};
    lts_soil_find(soil, p, 0, now, place_of_point, &of, moved);
    for (size_t i = 0; i < now; ++i) {
      const double *from = of.points + 3 * i;
      double *to = out + 3 * (done + i), local[3], world[3];
      const float *d = moved + 3 * i;
      memmove(to, from, 3 * sizeof *to);
      if (d[0] == 0.0f && d[1] == 0.0f && d[2] == 0.0f) continue;
      for (int k = 0; k < 3; ++k) local[k] = soil->scale * d[k];
      lts_place_unlaid(&p->s.place, local, world);
      for (int k = 0; k < 3; ++k) to[k] += world[k];
    }
  }
  return LTS_OK;
}

/* ---- what networks see and say ---- */

int lts_soil_see(lts_soil *soil, float *bins, float *scalars) {
  LTS_TRY(lts_soil_check_started(soil));
  const lts_soil_model *m = soil->model;
  const lts_passage *p = &soil->passage[soil->now];
  lts_soil_make_frame(soil, p, 1);
  const size_t n = LTS_SOIL_ROW(soil, p->s.n_strip);
  for (size_t k = 0; bins && k < n; ++k) {
    for (int c = 0; c < LTS_SOIL_CHANNELS; ++c) *bins++ = soil->bins[c][k];
  }
  for (int j = 0; scalars && j < p->s.n_strip; ++j) {
    memcpy(scalars + j * m->n_scalar, soil->scalars[j], (size_t)m->n_scalar * sizeof *scalars);
  }
  return p->s.n_strip;
}

int lts_soil_loads(lts_soil *soil, float *out) {
  LTS_TRY(lts_soil_check_started(soil));
  if (!out) return LTS_ERROR_NULL;
  lts_soil_find_loads(soil, &soil->passage[soil->now], soil->members, out);
  return LTS_OK;
}

static void place_across(const void *of, size_t i, double out[3]) {
  const double *place = (const double *)of + 2 * i;
  out[0] = place[0];
  out[1] = 0.0;
  out[2] = place[1];
}

int lts_soil_rise(lts_soil *soil, const double *places, size_t n, float *out) {
  LTS_TRY(lts_soil_check_started(soil));
  if (n && (!places || !out)) return LTS_ERROR_NULL;
  lts_soil_find(soil, &soil->passage[soil->now], 1, n, place_across, places, out);
  return LTS_OK;
}
