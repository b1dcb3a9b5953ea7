/* The soil field behind a page: what JavaScript calls, over memory of its own. Compiled with LTS_MODEL, the symbol of
 * the model. There is one terrain with one tool. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lts_soil.h"

#define EXPORT(name) __attribute__((export_name(#name))) name

extern const lts_soil_model LTS_MODEL;

static lts_terrain ground;
static lts_soil_tool tool;
static lts_soil *soil;
static lts_soil *traced; /* the same tool, whose anchors tell where particles are */
static void *memory, *more;
static lts_soil_result result;
static double pose[7]; /* x y z, w x y z: JavaScript writes it */
static double numbers[24];
static char words[256];
static double rate, slow; /* m/s, up, of a tool that is free in height; what its motion is damped to */

double *EXPORT(page_pose)(void) { return pose; }
/* What `page_make` reads: width, radius, length, bucket, plates, rise and share of the floor, lugs, lug height of
 * the tool; cells (2), corner (2), sides (2), walls, floor, friction angle, density and gravity of the terrain. */
double *EXPORT(page_numbers)(void) { return numbers; }
double *EXPORT(page_heights)(void) { return ground.heights; }
double *EXPORT(page_force)(void) { return result.force; }
double *EXPORT(page_torque)(void) { return result.torque; }
double *EXPORT(page_place)(void) { return result.pose.position; }
double EXPORT(page_bound)(void) { return result.bound; }
double EXPORT(page_payload)(void) { return result.payload; }
int EXPORT(page_status)(void) { return result.now.status; }
double *EXPORT(page_points)(int n) { return malloc(sizeof(double) * 3 * (size_t)n); }
void EXPORT(page_free)(void *points) { free(points); }

static lts_pose coming(void) {
  lts_pose to;
  memcpy(to.position, pose, sizeof to.position);
  memcpy(to.rotation, pose + 3, sizeof to.rotation);
  return to;
}

/* A tool on a terrain, whose heights are to be written before `page_start`. */
int EXPORT(page_make)(void) {
  if (soil) lts_soil_close(soil);
  if (traced) lts_soil_close(traced);
  soil = traced = NULL;
  free(memory);
  free(more);
  free(ground.heights);
  memset(&ground, 0, sizeof ground);
  const double *v = numbers;
  memcpy(&tool, v, sizeof tool);
  v += sizeof tool / sizeof *v;
  for (int i = 0; i < 2; ++i) {
    ground.n[i] = (int32_t)v[i];
    ground.corner[i] = v[2 + i];
    ground.cell[i] = v[4 + i];
  }
  ground.walled = v[6] != 0.0;
  ground.floor = v[7];
  ground.friction_angle_deg = v[8];
  ground.density = v[9];
  ground.gravity = v[10];
  ground.heights = calloc((size_t)ground.n[0] * (size_t)ground.n[1], sizeof(double));
  const size_t size = lts_soil_size(&LTS_MODEL, &tool, &ground);
  memory = size ? malloc(size) : NULL;
  more = size ? malloc(size) : NULL;
  if (size == 0) return LTS_ERROR_VALUE;
  if (!ground.heights || !memory || !more) return LTS_ERROR_MEMORY;
  const int code = lts_soil_init(&LTS_MODEL, &tool, &ground, memory, size, LTS_BEST, &soil);
  return code < 0 ? code : lts_soil_init(&LTS_MODEL, &tool, &ground, more, size, LTS_BEST, &traced);
}

int EXPORT(page_start)(void) {
  const lts_pose to = coming();
  rate = slow = 0.0;
  return lts_soil_start(soil, &to, &result);
}

/* To the pose within dt s. */
int EXPORT(page_step)(double dt) {
  const lts_pose to = coming();
  rate = slow = 0.0;
  return lts_soil_step(soil, &to, dt, &result);
}

/* Of soil_field/loaded.py: m in which soil unloads, s in which it follows an even motion, m above the floor, and what
 * bears there, N/m. */
#define UNLOADS 0.002
#define SLOW 0.2
#define ABOVE_FLOOR 1e-6
#define FLOOR 1e9

/* What soil damps of a motion at a speed up, N: no more than it bears, and nothing of what sinks. */
static double damped(double force, double speed, double mass, double weight) {
  const double swing = fmax(speed - fmax(slow, 0.0), 0.0);
  return -fmin(2.0 * sqrt(mass * weight / UNLOADS) * swing, fmax(force, 0.0));
}

static double lowest(void) { return ground.floor + tool.radius + ABOVE_FLOOR; }

/* By how much a mass at a height is held too little within dt s, N: backward Euler. */
static int residual(lts_pose *to, double height, double mass, double weight, double dt, double *out) {
  lts_soil_result there;
  const double below = fmin(height - lowest(), 0.0);
  height -= below;
  to->position[1] = height;
  const int code = lts_soil_propose(soil, to, dt, &there);
  const double speed = (height - result.pose.position[1]) / dt, force = there.force[1];
  *out = mass * (speed - rate) / dt - force - damped(force, speed, mass, weight) + weight + FLOOR * below;
  return code;
}

/* To the pose within dt s, at the height that a weight (N) takes: the residual grows with the height, so a bracket
 * that doubles holds the root, and regula falsi (Illinois) finds it. */
int EXPORT(page_sink)(double weight, double dt) {
  const double last = result.pose.position[1], mass = weight / ground.gravity;
  lts_pose to = coming();
  double a = fmax(last + dt * rate, lowest()), fa, b = a, fb;
  int code = residual(&to, a, mass, weight, dt, &fa);
  if (code < 0) return code;
  double step = fa > 0.0 ? -1e-5 : 1e-5;
  for (;;) {
    b += step;
    if ((code = residual(&to, b, mass, weight, dt, &fb)) < 0) return code;
    if (fa * fb <= 0.0) break;
    a = b;
    fa = fb;
    step *= 2.0;
    if (fabs(step) > 1.0) return LTS_ERROR_PLACE; /* the soil does not carry it */
  }
  for (int i = 0; i < 60 && fabs(b - a) > 1e-7 && fb != 0.0; ++i) {
    const double middle = b - fb * (b - a) / (fb - fa);
    double fm;
    if ((code = residual(&to, middle, mass, weight, dt, &fm)) < 0) return code;
    if (fm * fb < 0.0) {
      a = b;
      fa = fb;
    } else {
      fa *= 0.5;
    }
    b = middle;
    fb = fm;
  }
  to.position[1] = b = fmax(b, lowest());
  code = lts_soil_step(soil, &to, dt, &result);
  if (code < 0) return code;
  const double force = result.force[1];
  rate = (b - last) / dt;
  result.force[1] += damped(force, rate, mass, weight);
  slow = force > 0.0 ? slow + (rate - slow) * dt / (SLOW + dt) : 0.0;
  return code;
}

int EXPORT(page_update)(void) { return lts_terrain_update(&ground); }
double *EXPORT(page_sight)(void) {
  lts_soil_footprint(soil, numbers);
  return numbers;
}

/* Of the newest frame, or of an error; "" while all is well. */
char *EXPORT(page_reason)(int code) {
  words[0] = 0;
  if (code < 0) {
    strncpy(words, lts_error_text(code), sizeof words - 1);
  } else if (result.now.status) {
    lts_soil_reason(soil, &result.now, words, sizeof words);
  }
  return words;
}

int EXPORT(page_anchor)(void) { return lts_soil_anchor(traced, &result.pose, 0); }
int EXPORT(page_follow)(double dt) { return lts_soil_follow(traced, &result.pose, dt); }
int EXPORT(page_displace)(const double *from, int n, double *to) {
  return lts_soil_displacement(traced, from, (size_t)n, to);
}
