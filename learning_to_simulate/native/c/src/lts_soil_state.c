/* Memory of an instance, its tool, and the terrain that it is on. */
#include <math.h>
#include <string.h>

#include "lts_soil_internal.h"

static int is_usable(const lts_soil_model *m) { return m && m->abi == LTS_ABI; }

int lts_soil_describe(const lts_soil_model *m, lts_soil_description *out) {
  if (!m || !out) return LTS_ERROR_NULL;
  if (!is_usable(m)) return LTS_ERROR_MODEL;
  const lts_soil_description d = {m->abi,    m->kind,     m->n_member, m->n_bin,  LTS_SOIL_CHANNELS,
                                  m->n_scalar, m->n_judged, 0,           m->digest, m->judged_names};
  *out = d;
  return LTS_OK;
}

static int is_positive(double value) { return value > 0.0 && isfinite(value); }

static int is_tool(const lts_soil_model *m, const lts_soil_tool *t) {
  if (!t || !is_positive(t->width) || !is_positive(t->radius)) return 0;
  if (m->kind == LTS_SOIL_WHEEL) {
    return t->lugs >= 0.0 && isfinite(t->lugs) && t->lug_height >= 0.0 && isfinite(t->lug_height);
  }
  return is_positive(t->length) && (t->bucket == 0.0 || t->bucket == 1.0) &&
         (t->plates == 0.0 || t->plates == 1.0) &&
         (t->bucket == 0.0 || (fabs(t->floor_deg) < 90.0 && is_positive(t->floor_share)));
}

static double scale_of(const lts_soil_model *m, const lts_soil_tool *t) {
  if (m->kind == LTS_SOIL_WHEEL) return t->radius / m->rim;
  return t->width / fmin(fmax(t->width, m->taught_widths[0]), m->taught_widths[1]);
}

/* Cells whose middles lie in the rectangle that bins span: all of each lies within half a diagonal of it. */
static double most_cells(const lts_soil_model *m, const lts_soil_tool *tool, const lts_terrain *t) {
  const double scale = scale_of(m, tool), more = hypot(t->cell[0], t->cell[1]);
  const double along = scale * (m->n_bin - 1) * m->spacing + more;
  const double across = tool->width + 2.0 * scale * m->n_beside * m->beside_width + more;
  const double all = (double)t->n[0] * t->n[1];
  return fmin(floor(along * across / (t->cell[0] * t->cell[1])) + 1.0, all);
}

static int larger(int a, int b) { return a > b ? a : b; }

static int widest(const lts_soil_model *m) {
  const lts_soil_network *nets[3] = {&m->after, &m->surface, &m->soil};
  int most = 0;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < nets[i]->n_layer; ++k) most = larger(most, nets[i]->layers[k].columns);
  }
  return most;
}

/* What changes about cells in sight may fill: the square about the rectangle that bins span, and a margin. */
static double largest_box(const lts_soil_model *m, const lts_soil_tool *tool, const lts_terrain *t) {
  const double scale = scale_of(m, tool), along = scale * (m->n_bin - 1) * m->spacing;
  const double side = hypot(along, tool->width + 2.0 * scale * m->n_beside * m->beside_width);
  double cells = 1.0;
  for (int i = 0; i < 2; ++i) cells *= fmin(ceil(side / t->cell[i]) + 1.0, (double)t->n[i]) + 2.0;
  return cells;
}

static size_t lay_out(const lts_soil_model *m, const lts_soil_tool *tool, const lts_terrain *t, char *base,
                      lts_soil *soil) {
  const size_t cells = (size_t)most_cells(m, tool, t), box = (size_t)largest_box(m, tool, t);
  const size_t bins = (size_t)m->n_bin, lanes = LTS_SOIL_LANES, wide = (size_t)widest(m);
  const size_t strips = m->n_column > 1 ? (size_t)(m->n_column + 2 * m->n_beside) : 1;
  const size_t rows = 2 * (size_t)m->n_column, members = (size_t)m->n_member;
  const size_t own = (size_t)m->load_own.columns, ld_side = (size_t)LTS_PADDED(m->side.n_row);
  const int of_places = larger(m->soil.layers[0].rows, m->surface.layers[0].rows);
  const size_t ld = (size_t)LTS_PADDED(larger(m->load.n_row, of_places));
  size_t at = lts_aligned(sizeof(lts_soil), LTS_ALIGNMENT);
#define TAKE(field, type, count) LTS_TAKE(soil->field, type, count, LTS_ALIGNMENT);
  for (int i = 0; i < 2; ++i) {
    TAKE(passage[i].surface, double, strips * bins)
    TAKE(passage[i].profile, double, strips * bins)
    TAKE(passage[i].last, double, strips * bins)
    TAKE(passage[i].area_before, double, strips * bins)
    TAKE(passage[i].struck, double, strips * bins)
    TAKE(cells[i].number, int32_t, cells)
    TAKE(cells[i].before, double, cells)
    TAKE(cells[i].left, double, cells)
    TAKE(cells[i].u, double, cells)
    TAKE(cells[i].across, double, cells)
  }
  for (int i = 0; i < LTS_SOIL_CHANNELS; ++i) TAKE(bins[i], float, strips * bins + 1)
  TAKE(gone, int32_t, cells)
  TAKE(box, double, box)
  for (int i = 0; i < 2; ++i) TAKE(moved[i], double, (size_t)t->n[1])
  TAKE(kept, unsigned char, (size_t)t->n[0] * (size_t)t->n[1])
  TAKE(risen, float, cells)
  TAKE(under, double, bins)
  TAKE(fresh, double, strips * bins)
  TAKE(first, double, bins)
  TAKE(second, double, bins)
  TAKE(places, lts_places, 1)
  TAKE(inputs, float, lanes * ld)
  TAKE(sides, float, rows * ld_side)
  TAKE(a, float, rows * own)
  for (int i = 0; i < 2; ++i) TAKE(rows[i], float, lanes * wide) /* lanes are more than the two sides of all strips */
  TAKE(bias, float, (size_t)m->n_column * own)
  TAKE(out, float, lanes * LTS_PANEL)
  TAKE(loads, float, 6 * members)
#undef TAKE
  return at;
}

size_t lts_soil_size(const lts_soil_model *m, const lts_soil_tool *tool, const lts_terrain *terrain) {
  if (!is_usable(m) || !is_tool(m, tool) || !lts_terrain_usable(terrain)) return 0;
  return lay_out(m, tool, terrain, NULL, NULL) + LTS_ALIGNMENT - 1;
}

/* Scale, units, scalars and strips of the tool: `tools.py` and `place.py`. */
static void fit_tool(lts_soil *soil) {
  const lts_soil_model *m = soil->model;
  const lts_soil_tool *t = &soil->tool;
  const lts_terrain *ground = soil->terrain;
  const double s = soil->scale = scale_of(m, t), degree = LTS_PI / 180.0;
  const double friction = tan(ground->friction_angle_deg * degree);
  const double weight = ground->density * ground->gravity / (m->standard_density * m->standard_gravity);
  const double edge = t->radius / s + m->bucket_edge * t->bucket;
  const double stress = log(weight * s);
  const double rise = t->bucket != 0.0 ? t->floor_deg : m->floor_deg;
  const double share = t->bucket != 0.0 ? t->floor_share : m->floor_share;
  const double blade[] = {t->width / 2.0 / s, friction,      t->radius / s, t->length / s, t->bucket,
                          t->plates,          rise * degree, share,         edge,          stress};
  const double wheel[] = {t->width / 2.0 / s, friction, m->rim, t->lugs, t->lug_height / s, stress};
  for (int i = 0; i < m->n_own; ++i) {
    soil->own[i] = (float)(m->kind == LTS_SOIL_WHEEL ? wheel : blade)[i];
  }
  for (int i = 0; i < 6; ++i) soil->units[i] = weight * s * s * s * (i < 3 ? 1.0 : s);
  soil->width = t->width / s;
  soil->radius = fmax(t->radius / s, m->spacing / 2.0); /* a sharper edge would fall between the bins */
  soil->time = sqrt(m->standard_gravity / ground->gravity * s);
  for (int i = 0; i < m->n_column; ++i) {
    soil->centres[m->n_beside + i] = (i - (m->n_column - 1.0) / 2.0) * soil->width / m->n_column;
    soil->widths[m->n_beside + i] = soil->width / m->n_column;
  }
  for (int i = 0; i < m->n_beside; ++i) {
    const int left = m->n_beside - 1 - i, right = m->n_beside + m->n_column + i;
    soil->centres[right] = soil->width / 2.0 + m->beside_width * (i + 0.5);
    soil->centres[left] = -soil->centres[right];
    soil->widths[left] = soil->widths[right] = m->beside_width;
  }
  if (m->kind == LTS_SOIL_BLADE && t->bucket != 0.0) lts_soil_fit_bucket(soil);
}

int lts_soil_init(const lts_soil_model *m, const lts_soil_tool *tool, lts_terrain *terrain, void *memory,
                  size_t size, int kernel, lts_soil **out) {
  if (!m || !tool || !terrain || !memory || !out) return LTS_ERROR_NULL;
  if (!is_usable(m)) return LTS_ERROR_MODEL;
  const size_t needed = lts_soil_size(m, tool, terrain);
  if (!needed) return LTS_ERROR_VALUE;
  if (size < needed) return LTS_ERROR_MEMORY;
  int found = 0;
  const lts_kernels *run = lts_find_kernels(kernel, &found);
  if (!run) return LTS_ERROR_VALUE;
  lts_soil *soil = lts_cleared(memory, lay_out(m, tool, terrain, NULL, NULL));
  lay_out(m, tool, terrain, (char *)soil, soil);
  soil->model = m;
  soil->run = run;
  soil->terrain = terrain;
  soil->tool = *tool;
  soil->kernel = found;
  soil->members = m->n_member;
  soil->most_cells = (int32_t)most_cells(m, tool, terrain);
  fit_tool(soil);
  soil->magic = LTS_MAGIC;
  lts_soil **end = &terrain->first;
  while (*end) end = &(*end)->next;
  *end = soil;
  *out = soil;
  return LTS_OK;
}

int lts_soil_check_started(const lts_soil *soil) {
  LTS_TRY(lts_check(soil));
  return soil->started ? LTS_OK : LTS_ERROR_CALL;
}

int lts_soil_close(lts_soil *soil) {
  LTS_TRY(lts_check(soil));
  lts_soil_write(soil);
  lts_soil **at = &soil->terrain->first;
  while (*at && *at != soil) at = &(*at)->next;
  if (*at) *at = soil->next;
  soil->magic = 0;
  return LTS_OK;
}

int lts_soil_kernel(const lts_soil *soil) {
  LTS_TRY(lts_check(soil));
  return soil->kernel;
}

int lts_soil_members(lts_soil *soil, int members) {
  LTS_TRY(lts_check(soil));
  if (members < 1 || members > soil->model->n_member) return LTS_ERROR_VALUE;
  soil->members = members;
  return LTS_OK;
}
