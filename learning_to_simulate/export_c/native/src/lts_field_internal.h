/* An instance of a swept field: its state, which is saved and loaded, and the work space. */
#ifndef LTS_FIELD_INTERNAL_H
#define LTS_FIELD_INTERNAL_H

#include "lts_common.h"
#include "lts_field_model.h"
#include "lts_kernels.h"

#define LTS_FIELD_MAGIC 0x4c544632u
#define LTS_FIELD_ROWS 48 /* particles that go through a network at once: they stay in the first cache */

/* Channels of a frame's bins, and the first numbers of its scalars; the last four are area, foremost,
 * half width and end. */
enum { LTS_CUT, LTS_SURFACE, LTS_SINCE, LTS_AREA_BEFORE, LTS_INFLUENCE, LTS_DISTURBED, LTS_CHANNELS };
enum { LTS_TIP, LTS_HEIGHT, LTS_LEAN, LTS_SPEED, LTS_RISE, LTS_TURN };
#define LTS_MOST_SCALARS (10 + 3 * LTS_FIELD_SCALES)

/* What particles at rest depend on, besides a bed that was given. */
typedef struct {
  double origin, level, end, floor, width; /* u of the tool's first place; m */
} lts_field_ground;

typedef struct {
  int32_t started, has_bed; /* has_bed: particles of a bed that was given follow the bins */
  int32_t frame, unused;
  lts_field_ground ground;
  lts_pose pose;                             /* as it was given */
  double position[2], lean, velocity[3];     /* of u and height, m and m/s; lean, rad and rad/s */
  double memory[LTS_FIELD_SCALES][3];
  double travelled, foremost;
  lts_field_result result;
  lts_judgement judged;
} lts_field_head;

struct lts_field {
  uint32_t magic;
  int32_t kernel, of_force, of_particles;
  const lts_field_model *model;
  const lts_kernels *run;
  /* State: the head, then [n_bin] each, then the bed. */
  lts_field_head *head;
  double *surface, *profile, *last, *area_before;
  float *bed; /* [N][3] m */
  /* Work space: the newest frame, */
  int32_t placed, local_is_of_bed; /* placed: whether `points` is of the newest state */
  int32_t has_local, unused;
  lts_field_ground local_of; /* what `local` was computed for */
  float *bins[LTS_CHANNELS]; /* [n_bin], and on either side 2 n_pad times the outermost one */
  float scalars[LTS_MOST_SCALARS];
  /* particles at rest as u, height and distance from the middle from the tool's first place and level,
   * with the bin of u and the share of the next one, and their share beside the blade, */
  float *u, *y, *z, *share, *beside; /* [N] */
  int32_t *low, *moving;             /* [N]; low: at most n_pad beyond the bins */
  float *gate, *points;              /* [N], [N][3] */
  /* and rows on their way through a network. */
  float *seen, *shared, *bias, *a, *b, *out;
  double *top, *median, *heights; /* [2 N], [2 N] and [n_bin], of a bed that is read */
};

size_t lts_field_lay_out(const lts_field_model *model, char *base, lts_field *soil);
/* Bytes of the state, with or without the particles of a bed. */
size_t lts_field_bytes(const lts_field_model *model, int has_bed);
int lts_field_check(const lts_field *soil);
int lts_field_check_started(const lts_field *soil);
int lts_field_n_scalar(const lts_field_model *model);

/* lts_field_bed.c: `plane` of a point: u, height, distance from the middle, m. */
void lts_field_plane(const lts_field_model *model, const float point[3], double plane[3]);
/* Reads surface, level, end and floor of particles [N][3] for a tool at u. */
int lts_field_read_bed(lts_field *soil, const float *points, double u, double width, double *surface,
                       lts_field_ground *ground);
/* The flat bed, its columns stretched to heights, into particles [N][3]. */
int lts_field_stretch(const lts_field_model *model, const lts_field_bed *bed, float *points);

/* lts_field_path.c */
void lts_field_begin(lts_field *soil, const double plane[3], const double velocity[3]);
void lts_field_go(lts_field *soil, const double plane[3], double dt);
/* Bins and scalars that the force sees; those that only particles see. */
void lts_field_see(lts_field *soil);
void lts_field_see_reach(lts_field *soil);

/* lts_field_inputs.c */
typedef struct {
  int low;
  float share;
} lts_place;
lts_place lts_field_place(const lts_field_model *model, float u);
float lts_field_contact(const lts_field *soil);
void lts_field_force_inputs(const lts_field *soil, float *out);
void lts_field_shared_inputs(const lts_field *soil, float *out);
/* Own inputs [n][ld] of particles. */
void lts_field_own_inputs(const lts_field *soil, const int32_t *which, int n, float *out, int ld);

#endif
