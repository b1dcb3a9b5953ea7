/* Where a tool works on a terrain: its vertical plane of travel, and the world seen from there. Twin of
 * `soil_field/place.py`. */
#include <math.h>

#include "lts_soil_internal.h"

int lts_soil_unit_pose(const lts_pose *pose, lts_pose *out) {
  return fabs(lts_length(pose->rotation, 4) - 1.0) <= 1e-3 && lts_usable_pose(pose, out);
}

int lts_place_of(const lts_pose *pose, lts_place *out) {
  const double upright[3] = {0.0, 0.0, -1.0};
  double across[3];
  lts_rotate(pose->rotation, upright, across);
  const double length = sqrt(across[0] * across[0] + across[2] * across[2]);
  if (!(length >= 1e-3)) return 0; /* on its side it looks nowhere */
  out->origin[0] = pose->position[0];
  out->origin[1] = pose->position[2];
  out->across[0] = across[0] / length;
  out->across[1] = across[2] / length;
  out->along[0] = out->across[1];
  out->along[1] = -out->across[0];
  out->grade = out->height = 0.0;
  out->cosine = 1.0;
  return 1;
}

/* Along, up and across of a vector of the world. */
static void local_vector(const lts_place *place, const double v[3], double out[3]) {
  const double x = v[0], y = v[1], z = v[2];
  out[0] = x * place->along[0] + z * place->along[1];
  out[1] = y;
  out[2] = x * place->across[0] + z * place->across[1];
}

void lts_place_local(const lts_place *place, const double point[3], double out[3]) {
  const double from[3] = {point[0] - place->origin[0], point[1], point[2] - place->origin[1]};
  local_vector(place, from, out);
}

void lts_place_laid(const lts_place *place, const double local[3], double out[3]) {
  const double c = place->cosine, s = place->grade * c, u = local[0], over = local[1] - place->height;
  out[0] = c * u + s * over;
  out[1] = place->height - s * u + c * over;
  out[2] = local[2];
}

void lts_place_unlaid(const lts_place *place, const double v[3], double out[3]) {
  const double c = place->cosine, s = place->grade * c;
  const double along = c * v[0] - s * v[1], up = s * v[0] + c * v[1], across = v[2];
  out[0] = along * place->along[0] + across * place->across[0];
  out[1] = up;
  out[2] = along * place->along[1] + across * place->across[1];
}

void lts_place_turns(const lts_place *place, const lts_pose *pose, double out[3]) {
  const double upright[2][3] = {{0.0, 1.0, 0.0}, {0.0, 0.0, -1.0}};
  double up[3], across[3];
  lts_rotate(pose->rotation, upright[0], up);
  lts_rotate(pose->rotation, upright[1], across);
  local_vector(place, up, up);
  local_vector(place, across, across);
  out[0] = atan2(-up[0], up[1]);
  out[1] = atan2(across[0], across[2]);
  out[2] = atan2(across[1], hypot(across[0], across[2]));
}
