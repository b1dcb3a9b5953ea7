/* An instance of a swept field: its state, which is saved and loaded, and the work space. */
#ifndef LTS_FIELD_INTERNAL_H
#define LTS_FIELD_INTERNAL_H

#include "lts_common.h"
#include "lts_field_model.h"
#include "lts_kernels.h"

#define LTS_FIELD_MAGIC 0x4c544632u
#define LTS_FIELD_ROWS 48 /* particles that go through a network at once: they stay in the first cache */

/* The first numbers of a blade's scalars; the last six are area, foremost, half width, end, room and pressed. */
enum { LTS_TIP, LTS_HEIGHT, LTS_LEAN, LTS_SPEED, LTS_RISE, LTS_TURN };
#define LTS_MOST_SCALARS (23 + 3 * LTS_FIELD_SCALES)
#define LTS_MOST_LOADS 4 /* force along and up, torque; of a wheel the change of its height */

/* What particles at rest depend on, besides a bed that was given. */
typedef struct {
  double origin, level, end, floor, width; /* u of the tool's first place; m */
} lts_field_ground;

/* What is given of a wheel so far; twin of `wheel.DriveState`. */
typedef struct {
  double radius, width, gravity, friction;     /* m, m/s2; tan of the friction angle */
  double first_height, first_turned, first_load; /* of its first pose: m, rad, N */
  double turned, load, frame_load, peak_load;  /* frame_load: mean of the last frame */
  double sunk, contact;                        /* how deep it stood at first; half the chord; m */
  double rearmost, foremost;                   /* u, m */
  double way[3]; /* travelled and slipped in all, m; loaded, in shares of the first load */
} lts_field_drive;

typedef struct {
  int32_t started, has_bed; /* has_bed: particles of a bed that was given follow the bins */
  int32_t frame, unused;
  lts_field_ground ground;
  lts_pose pose;                             /* as it was given */
  double position[2], lean, velocity[3];     /* of u and height, m and m/s; lean, rad and rad/s; of a
                                              * wheel velocity is of travel and rim, m/s */
  double context[LTS_FIELD_CONTEXT];         /* of a wheel */
  lts_field_drive drive;
  double memory[LTS_FIELD_SCALES][3];
  double travelled, foremost, pressed; /* pressed: of a blade */
  lts_field_result result;
  lts_judgement judged;
} lts_field_head;

/* What differs between the tools. A plane is u, height and lean; of a wheel u, height, angle turned and
 * load. */
typedef struct {
  int n_row; /* rows [n_bin] of the state */
  /* Bins and scalars that the load sees; those that only particles see. */
  void (*see)(lts_field *soil);
  void (*see_reach)(lts_field *soil);
  /* What outputs are multiplied by; 0 where they are of no effect. */
  int (*load_share)(const lts_field *soil, float share[3]);
  void (*load_of)(const lts_field_model *model, const float *out, const float share[3],
                  double load[LTS_MOST_LOADS]);
  /* Moves a point that is in the tool out of it, by the shortest way. */
  void (*push_out)(const lts_field *soil, double point[3]);
} lts_field_tool;
extern const lts_field_tool lts_field_blade, lts_field_wheel;

struct lts_field {
  uint32_t magic;
  int32_t kernel, of_force, of_particles;
  const lts_field_model *model;
  const lts_kernels *run;
  const lts_field_tool *tool;
  /* State: the head, then [n_bin] each, then the bed. */
  lts_field_head *head;
  double *surface, *profile, *last;
  double *area_before;                /* of a blade */
  double *first, *slid, *shear, *peak; /* of a wheel; first: its first profile */
  float *bed; /* [N][3] m */
  /* Work space: the newest frame, */
  int32_t placed, local_is_of_bed; /* placed: whether `points` is of the newest state */
  int32_t has_local, unused;
  lts_field_ground local_of; /* what `local` was computed for */
  float *bins[LTS_CHANNELS]; /* [n_bin], and on either side 2 n_pad times the outermost one */
  float scalars[LTS_MOST_SCALARS];
  double axis[2]; /* from the middle of a blade's lower edge to that of the upper one, m */
  /* particles at rest as u, height and distance from the middle from the tool's first place and level,
   * with the bin of u and the share of the next one, and their share beside the blade, */
  float *u, *y, *z, *share, *beside; /* [N] */
  int32_t *low, *moving;             /* [N]; low: at most n_pad beyond the bins */
  float *gate, *points;              /* [N], [N][3] */
  /* and rows on their way through a network. */
  float *seen, *shared, *bias, *a, *b, *out;
  double *top, *median, *heights; /* [2 N], [2 N] and [n_bin], of a bed that is read */
  char *before;                   /* the state without its bed, for a step that may be refused */
};

size_t lts_field_lay_out(const lts_field_model *model, char *base, lts_field *soil);
/* Bytes of the state, with or without the particles of a bed. */
size_t lts_field_bytes(const lts_field_model *model, int has_bed);
int lts_field_check(const lts_field *soil);
int lts_field_check_started(const lts_field *soil);

/* lts_field_bed.c: `plane` of a point: u, height, distance from the middle, m. */
void lts_field_plane(const lts_field_model *model, const float point[3], double plane[3]);
/* Reads surface, level, end and floor of particles [N][3] for a tool at u. */
int lts_field_read_bed(lts_field *soil, const float *points, double u, double width, double *surface,
                       lts_field_ground *ground);
/* Particles [N][3] of a bed that a user gave, checked; a height map goes by way of `soil->points`. */
int lts_field_take_bed(lts_field *soil, const lts_field_bed *bed, const float **points);

/* lts_field_table.c: inputs of a table that looks at the tool; own inputs [n][ld] of particles; a channel at u
 * from the tool's first place, m. */
void lts_field_read(const lts_field *soil, const lts_table *table, float *out);
void lts_field_read_particles(const lts_field *soil, const int32_t *which, int n, float *out, int ld);
float lts_field_channel_at(const lts_field *soil, int channel, float u);

/* lts_field_load.c: what the tool feels, into the result; the mean change of a wheel's height, m. Needs
 * `see`. */
double lts_field_find_load(lts_field *soil, lts_field_result *result);

/* lts_field_soil.c: brings `points` up to the newest state. */
void lts_field_place_particles(lts_field *soil);

/* lts_field_step.c: u, height and lean of an upright tool, 0 where the pose has no numbers or no rotation;
 * the rates of these; and what begins on particles [N][3]; drive: sizes of a wheel, or null. Writes the state once
 * nothing can fail. */
int lts_field_plane_of(const lts_field_model *model, const lts_pose *pose, double plane[3]);
void lts_field_rates(const lts_field_model *model, const lts_twist *twist, double velocity[3]);
int lts_field_begin_on(lts_field *soil, const lts_pose *pose, const double plane[4],
                       const double velocity[3], const float *points, int has_bed, double width,
                       const lts_field_drive *drive, const double *context);

/* lts_field_path.c: of a blade, and what both tools sweep by. */
double lts_field_underside(double u, const double before[2], const double after[2], double radius);
void lts_field_cone(const double *values, int n, double fall, float scale, float most, float *out);
void lts_field_pad(lts_field *soil);
void lts_field_remember(lts_field *soil, double dt);
void lts_field_begin(lts_field *soil, const double plane[3], const double velocity[3]);
void lts_field_go(lts_field *soil, const double plane[3], double dt);
void lts_field_see(lts_field *soil);
void lts_field_see_reach(lts_field *soil);

/* lts_field_wheel_start.c: turns a lean into the angle turned since before, and adds the load. */
void lts_field_wheel_plane(const lts_field *soil, double plane[4]);
/* lts_field_wheel_path.c: the drive of a wheel, then the rut once its height is known. */
void lts_field_wheel_begin(lts_field *soil, const double plane[4], const double velocity[3]);
void lts_field_wheel_drive(lts_field *soil, const double plane[4], double dt);
void lts_field_wheel_sink(lts_field *soil, const double from[2], double height);
void lts_field_wheel_see(lts_field *soil);
void lts_field_wheel_see_reach(lts_field *soil);

#endif
