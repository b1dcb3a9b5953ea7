/* What the tool feels: the networks of the load. Twin of `load_inputs` and `load_of` of `soil_field/network.py`. */
#include <math.h>
#include <string.h>

#include "lts_soil_internal.h"

/* kappa of a strip: (10). */
static float contact(const lts_soil *soil, int strip) {
  const lts_soil_model *m = soil->model;
  const float *s = soil->scalars[strip];
  float highest = -HUGE_VALF;
  for (int i = 0; i < m->n_around; ++i) {
    const float u = s[LTS_SOIL_TIP] + m->around[i];
    const float height = lts_soil_channel_at(soil, LTS_SOIL_SURFACE, 1, strip, 0.0f, u);
    highest = height > highest ? height : highest;
  }
  const float carried = s[LTS_SOIL_OF_PASSAGE(m, CARRIED)];
  const float area = s[LTS_SOIL_AREA] > carried ? s[LTS_SOIL_AREA] : carried;
  const float heap = m->heap * sqrtf(area > 0.0f ? area : 0.0f);
  const float clearance = s[LTS_SOIL_HEIGHT] - s[m->radius] - highest;
  const float kappa = (heap + m->above - clearance) / m->ramp;
  return kappa > 0.0f ? (kappa < 1.0f ? kappa : 1.0f) : 0.0f;
}

/* Loads of one strip by its outputs towards one side: along, up, turn, and towards that side; (11). */
static void strip_load(const lts_soil_model *m, const float *out, double share, double load[4]) {
  const float limit = m->gain_limit;
  const float clipped = out[4] > limit ? limit : out[4] < -limit ? -limit : out[4];
  const double gain = exp((double)clipped);
  const double unit[4] = {m->force, m->force, m->torque, m->force};
  for (int i = 0; i < 4; ++i) load[i] = out[i] * gain * unit[i] * share;
  if (m->kind != LTS_SOIL_WHEEL) return;
  load[0] = load[1] * out[0]; /* a wheel bears what weighs on it */
  load[2] = m->rim * load[1] * out[2];
  load[3] = load[1] * out[3];
}

void lts_soil_run(const lts_soil *soil, const lts_soil_network *net, int member, const float *x, int ldx,
                  int rows) {
  const lts_dense *layer = net->layers + member * net->n_layer;
  for (int i = 0; i < net->n_layer; ++i, ++layer) {
    const int last = i + 1 == net->n_layer;
    float *to = last ? soil->out : soil->rows[i % 2];
    soil->run->dense(layer, x, ldx, rows, to, layer->columns, last ? LTS_NORMED : LTS_SILU, NULL, NULL);
    x = to;
    ldx = layer->columns;
  }
}

/* Sums over strips of the outputs [K][n_side] rows of one member: (12). */
static void sum_loads(const lts_soil *soil, const float *rows, int count, int n_side, const float *kappa,
                      float *out) {
  const lts_soil_model *m = soil->model;
  const double width = 2.0 * soil->scalars[0][LTS_SOIL_OWN];
  double sums[6] = {0.0};
  for (int k = 0; k < count; ++k) {
    double side[2][4];
    const double share = kappa[k] * width / (m->full_width * (double)count);
    for (int i = 0; i < n_side; ++i) {
      strip_load(m, rows + (k * n_side + i) * LTS_PANEL, share, side[i]);
    }
    if (n_side == 1) memcpy(side[1], side[0], sizeof side[0]);
    const double along = 0.5 * (side[0][0] + side[1][0]), up = 0.5 * (side[0][1] + side[1][1]);
    const double lever = (k - (count - 1.0) / 2.0) * width / count;
    sums[0] += along;
    sums[1] += up;
    sums[2] += side[0][3] - side[1][3];
    sums[3] -= lever * up;
    sums[4] += lever * along;
    sums[5] += 0.5 * (side[0][2] + side[1][2]);
  }
  for (int i = 0; i < 6; ++i) out[i] = (float)sums[i];
}

int lts_soil_find_loads(lts_soil *soil, const lts_passage *p, int members, float *out) {
  const lts_soil_model *m = soil->model;
  const lts_kernels *run = soil->run;
  int under;
  const int count = lts_soil_under(soil, p, &under), several = p->s.n_strip > 1, n_side = several ? 2 : 1;
  const int rows = count * n_side, width = m->load_own.columns / m->n_member;
  lts_places *at = soil->places;
  float kappa[LTS_SOIL_STRIPS], base[2 * LTS_SOIL_STRIPS];
  int32_t other[2 * LTS_SOIL_STRIPS];
  int touches = 0, of_strip[LTS_SOIL_OF_STRIP];
  lts_soil_scalars_of_strip(m, of_strip);
  lts_soil_make_frame(soil, p, 0);
  for (int k = 0; k < count; ++k) {
    kappa[k] = contact(soil, under + k);
    touches |= kappa[k] > 0.0f;
  }
  memset(out, 0, 6 * (size_t)members * sizeof *out);
  if (!touches) return 0;
  /* A strip has a row with its left and one with its right neighbour; one that stands alone is its own. */
  const int ld = LTS_PADDED(m->load.n_row), ld_side = LTS_PADDED(m->side.n_row);
  for (int pass = 0; pass < 2; ++pass) {
    at->n = pass ? rows : count;
    for (int i = 0; i < at->n; ++i) {
      const int k = pass ? i / n_side : i;
      at->strip[0][i] = under + k;
      at->share[0][i] = 0.0f;
      for (int s = 0; s < LTS_SOIL_OF_STRIP; ++s) at->of_strip[s][i] = soil->scalars[under + k][of_strip[s]];
      other[i] = !several ? 0 : i % 2 ? under + k + 1 : under + k - 1;
      base[i] = soil->scalars[0][LTS_SOIL_TIP];
    }
    lts_soil_inputs(soil, pass ? &m->side : &m->load, at, p->s.n_strip, base, pass ? other : NULL,
                    pass ? soil->sides : soil->inputs, pass ? ld_side : ld);
  }
  lts_dense own = m->load_own, side = m->load_side;
  own.columns = side.columns = members * width;
  run->dense(&own, soil->inputs, ld, count, soil->bias, own.columns, LTS_NORMED, NULL, NULL);
  for (int k = 0; k < count; ++k) { /* what a strip is to itself, as the bias of its sides */
    side.b = soil->bias + k * own.columns;
    run->dense(&side, soil->sides + k * n_side * ld_side, ld_side, n_side,
               soil->a + k * n_side * own.columns, own.columns, LTS_SILU, NULL, NULL);
  }
  for (int member = 0; member < members; ++member) {
    lts_soil_run(soil, &m->after, member, soil->a + member * width, own.columns, rows);
    sum_loads(soil, soil->out, count, n_side, kappa, out + 6 * member);
  }
  return touches;
}

double lts_soil_lowest_part(const lts_soil *soil) {
  const lts_soil_model *m = soil->model;
  const float *s = soil->scalars[0];
  const double bottom = (double)s[LTS_SOIL_HEIGHT] - (double)s[m->radius];
  if (m->kind != LTS_SOIL_BLADE) return bottom;
  /* A blade on its head hangs below its edge; its length follows the radius. */
  return bottom + fmin((double)s[m->radius + 1] * cos((double)s[LTS_SOIL_LEAN]), 0.0);
}

static void place_under(const void *of, size_t k, double out[3]) {
  const lts_soil *soil = of;
  const lts_soil_model *m = soil->model;
  const float *s = soil->scalars[0];
  out[0] = s[LTS_SOIL_TIP] + m->under_along[k / LTS_SOIL_UNDER_ACROSS];
  out[1] = 0.0;
  out[2] = s[LTS_SOIL_OWN] * m->under_across[k % LTS_SOIL_UNDER_ACROSS];
}

double lts_soil_contact(lts_soil *soil, const lts_passage *p) {
  const lts_soil_model *m = soil->model;
  int under;
  const int count = lts_soil_under(soil, p, &under);
  const double tip = soil->scalars[0][LTS_SOIL_TIP], reach = m->under_along[LTS_SOIL_UNDER_ALONG - 1];
  const int begin = (int)fmax((tip - reach) / m->spacing + m->n_behind - 1.0, 0.0);
  const int end = (int)fmin((tip + reach) / m->spacing + m->n_behind + 2.0, (double)m->n_bin);
  float highest = -HUGE_VALF, risen[LTS_SOIL_UNDER_ALONG * LTS_SOIL_UNDER_ACROSS];
  for (int k = begin; k < end; ++k) {
    if (!(fabs(lts_soil_offset(m, k) - tip) < reach)) continue;
    for (int j = under; j < under + count; ++j) {
      highest = fmaxf(highest, soil->bins[LTS_SOIL_SURFACE][LTS_SOIL_ROW(soil, j) + (size_t)k]);
    }
  }
  const double clearance = lts_soil_lowest_part(soil) - (double)highest;
  if (clearance <= (double)m->above) return 1.0;
  const size_t n = LTS_SOIL_UNDER_ALONG * LTS_SOIL_UNDER_ACROSS;
  lts_soil_find(soil, p, 1, n, place_under, soil, risen);
  float most = 0.0f;
  for (size_t k = 0; k < n; ++k) most = fmaxf(most, risen[k]);
  return fmin(fmax(((double)m->above - clearance + (double)most) / (double)m->ramp + 1.0, 0.0), 1.0);
}
