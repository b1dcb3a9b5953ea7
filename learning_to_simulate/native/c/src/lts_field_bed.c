/* The bed that a tool begins on: its surface from particles, twin of `tool/bed.py`. */
#include <math.h>
#include <string.h>

#include "lts_field_internal.h"

void lts_field_plane(const lts_field_model *m, const float point[3], double plane[3]) {
  plane[0] = m->sign * (double)point[m->axis];
  plane[1] = point[m->up];
  plane[2] = (double)point[3 - m->axis - m->up] - m->middle;
}

/* Sorts n values, few or nearly sorted. */
static void sort(double *values, int n) {
  for (int i = 1; i < n; ++i) {
    const double value = values[i];
    int k = i;
    for (; k > 0 && values[k - 1] > value; --k) values[k] = values[k - 1];
    values[k] = value;
  }
}

/* Median of the numbers among n values, which it sorts; NaN where there is none. */
static double median(double *values, int n) {
  int there = 0;
  for (int i = 0; i < n; ++i) {
    if (!isnan(values[i])) values[there++] = values[i];
  }
  sort(values, there);
  if (!there) return NAN;
  return 0.5 * (values[(there - 1) / 2] + values[there / 2]);
}

/* Value at x of a polygon through n points, the first and last beyond the ends. */
static double interpolated(const double *places, const double *values, int n, double x) {
  int low = 0, high = n - 1;
  if (x <= places[0]) return values[0];
  if (x >= places[high]) return values[high];
  while (high - low > 1) {
    const int middle = (low + high) / 2;
    *(places[middle] <= x ? &low : &high) = middle;
  }
  const double slope = (values[high] - values[low]) / (places[high] - places[low]);
  return slope * (x - places[low]) + values[low];
}

int lts_field_read_bed(lts_field *soil, const float *points, double u, double width, double *surface,
                       lts_field_ground *ground) {
  const lts_field_model *m = soil->model;
  const int n = m->n_soil, capacity = 2 * n;
  double low[3], high[3], plane[3], first[3];
  for (int i = 0; i < n; ++i) {
    lts_field_plane(m, points + 3 * i, plane);
    for (int k = 0; k < 3; ++k) {
      low[k] = i && low[k] < plane[k] ? low[k] : plane[k];
      high[k] = i && high[k] > plane[k] ? high[k] : plane[k];
    }
  }
  /* The strip that counts, and where its first particles lie. */
  const double middle = 0.5 * (low[2] + high[2]), size = 2.0 * m->kept_spacing;
  double last[3];
  int found = 0;
  for (int i = 0; i < n; ++i) {
    lts_field_plane(m, points + 3 * i, plane);
    if (!(fabs(plane[2] - middle) <= 0.5 * width)) continue;
    for (int k = 0; k < 3; ++k) {
      first[k] = found && first[k] < plane[k] ? first[k] : plane[k];
      last[k] = found && last[k] > plane[k] ? last[k] : plane[k];
    }
    found = 1;
  }
  if (!found) return LTS_ERROR_VALUE;
  const double n_slab = floor((last[0] - first[0]) / size) + 1.0;
  const double n_column = floor((last[2] - first[2]) / size) + 1.0;
  if (!(n_slab * n_column <= capacity)) return LTS_ERROR_VALUE; /* nothing that N particles fill */
  const int slabs = (int)n_slab, columns = (int)n_column;
  for (int i = 0; i < slabs * columns; ++i) soil->top[i] = NAN;
  for (int i = 0; i < n; ++i) {
    lts_field_plane(m, points + 3 * i, plane);
    if (!(fabs(plane[2] - middle) <= 0.5 * width)) continue;
    const int slab = (int)floor((plane[0] - first[0]) / size);
    const int column = (int)floor((plane[2] - first[2]) / size);
    double *top = soil->top + slab * columns + column;
    if (!(*top >= plane[1])) *top = plane[1];
  }
  /* The polygon goes where the tops were: median k is written after row k has been read. */
  double *centres = soil->median, *medians = soil->median + n;
  int there = 0;
  for (int slab = 0; slab < slabs && there < n; ++slab) {
    const double height = median(soil->top + slab * columns, columns);
    if (isnan(height)) continue;
    centres[there] = first[0] + size * (slab + 0.5);
    medians[there++] = height;
  }
  double *of_bed = soil->top;
  int inside = 0;
  for (int k = 0; k < m->n_bin; ++k) {
    const double place = u + (m->first + k * m->bin);
    surface[k] = interpolated(centres, medians, there, place) + 0.5 * m->spacing;
    if (place >= low[0] && place <= high[0]) of_bed[inside++] = surface[k];
  }
  if (!inside) memcpy(of_bed, surface, (size_t)m->n_bin * sizeof *surface);
  ground->origin = u;
  ground->level = median(of_bed, inside ? inside : m->n_bin);
  ground->end = high[0] + 0.5 * m->spacing;
  ground->floor = low[1] - 0.5 * m->spacing;
  ground->width = width;
  return LTS_OK;
}

/* The flat bed, its columns stretched to heights, into particles [N][3]. */
static int stretch(const lts_field_model *m, const lts_field_bed *bed, float *points) {
  double low = HUGE_VAL, top = -HUGE_VAL, plane[3];
  for (int i = 0; i < m->n_soil; ++i) {
    lts_field_plane(m, m->rest + 3 * i, plane);
    low = plane[1] < low ? plane[1] : low;
    top = plane[1] > top ? plane[1] : top;
  }
  top += 0.5 * m->spacing;
  for (int k = 0; k < bed->n; ++k) {
    if (!isfinite(bed->places[k]) || !isfinite(bed->heights[k])) return LTS_ERROR_VALUE;
    if (k && !(bed->places[k] >= bed->places[k - 1])) return LTS_ERROR_VALUE;
    if (!(bed->heights[k] > low)) return LTS_ERROR_PLACE;
  }
  memcpy(points, m->rest, 3 * (size_t)m->n_soil * sizeof *points);
  for (int i = 0; i < m->n_soil; ++i) {
    const double wanted =
        interpolated(bed->places, bed->heights, bed->n, (double)m->rest[3 * i + m->axis]);
    float *height = points + 3 * i + m->up;
    *height = (float)(low + (*height - low) * (wanted - low) / (top - low));
  }
  return LTS_OK;
}

int lts_field_take_bed(lts_field *soil, const lts_field_bed *bed, const float **points) {
  if (bed->n) {
    if (!bed->places || !bed->heights) return LTS_ERROR_NULL;
    if (bed->n < 2) return LTS_ERROR_VALUE;
    soil->placed = 0;
    *points = soil->points;
    return stretch(soil->model, bed, soil->points);
  }
  if (!bed->particles) return LTS_ERROR_NULL;
  for (size_t i = 0; i < 3 * (size_t)soil->model->n_soil; ++i) {
    if (!isfinite(bed->particles[i])) return LTS_ERROR_VALUE;
  }
  *points = bed->particles;
  return LTS_OK;
}
