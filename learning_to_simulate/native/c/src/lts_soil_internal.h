/* An instance of a soil field: two passages, one of which is the tool's and the other a trial, and the work space. */
#ifndef LTS_SOIL_INTERNAL_H
#define LTS_SOIL_INTERNAL_H

#include "lts_common.h"
#include "lts_kernels.h"
#include "lts_soil_model.h"

#define LTS_SOIL_ROWS 5
#define LTS_SOIL_OF_STRIP 5
#define LTS_SOIL_INSIDE 10 /* corners of the inside of a bucket */
#define LTS_SOIL_LANES 48 /* places that go through a network at once: they stay in the first cache */

/* The vertical plane of a passage: origin, and level unit vectors, x and z of each; m; rise of its ground per way,
 * cosine of its angle, and its height over the origin, m. Twin of `place.py`. */
typedef struct {
  double origin[2], along[2], across[2], grade, cosine, height;
} lts_place;

/* What a passage is beside its bins; lengths of the field. Twin of `sweep.Sweep`, of whose columns all share
 * their path, and of `passage.py`. */
typedef struct {
  lts_place place;
  double level, origin, pose[3]; /* pose: u and height of the circle's centre, lean */
  double memory[LTS_SOIL_MEMORIES][LTS_SOIL_MOTIONS], travelled, way, speed;
  double foremost[LTS_SOIL_STRIPS], dropped[LTS_SOIL_STRIPS], begun[LTS_SOIL_STRIPS];
  /* Of (19): m3 of the field that cells out of sight have risen, m2 that were cut there; what the soil carried falls
   * short of all that was cut, before a chunk left, and the way then. */
  double left_behind, dropped_there, owed, owed_at;
  double payload, taken;  /* m2 of soil in the bucket when it was last in the air; what it took up in the last step */
  int32_t bears, unused;  /* bears: whether the soil bears on the tool in the newest frame */
  int32_t n_strip, looks; /* looks: whether to see if the terrain goes on being even */
  int32_t cells, stale;   /* which of the instance's cells are in sight; whether their heights are old */
  int32_t n_gone, lifted; /* cells that the bins have left in the last step; whether the tool is over the soil */
} lts_way;

typedef struct {
  lts_way s;
  double *surface, *profile, *last, *area_before, *struck; /* LTS_SOIL_ROWS of [strips][n_bin] */
} lts_passage;

/* The rows of a passage from the bin `at` on. */
static inline void lts_soil_rows(const lts_passage *p, size_t at, double *out[LTS_SOIL_ROWS]) {
  double *const rows[LTS_SOIL_ROWS] = {p->surface, p->profile, p->last, p->area_before, p->struck};
  for (int i = 0; i < LTS_SOIL_ROWS; ++i) out[i] = rows[i] + at;
}

/* Cells in sight, ascending: their numbers in the flat map, heights before the tool and as it left them (m), u and
 * distance across of their middles (m of the field). */
typedef struct {
  int32_t n;
  int32_t *number;
  double *before, *left, *u, *across;
} lts_cells;

/* Places on their way through a network. */
typedef struct {
  int n;
  float u[LTS_SOIL_LANES], y[LTS_SOIL_LANES], z[LTS_SOIL_LANES];
  /* Lower strip and share of the next one: here, farther from the middle, nearer to it. */
  int32_t strip[3][LTS_SOIL_LANES];
  float share[3][LTS_SOIL_LANES];
  float here[LTS_SOIL_CHANNELS][LTS_SOIL_LANES];
  float of_strip[LTS_SOIL_OF_STRIP][LTS_SOIL_LANES]; /* scalars that differ from strip to strip */
  float gate[LTS_SOIL_LANES];
  size_t which[LTS_SOIL_LANES];
  int knows_tool; /* whether the inputs of all lanes hold what one strip shows of the tool */
} lts_places;

struct lts_soil {
  uint32_t magic;
  int32_t kernel, members, most_cells;
  const lts_soil_model *model;
  const lts_kernels *run;
  lts_terrain *terrain;
  lts_soil *next; /* on the terrain */
  lts_soil_tool tool;
  double scale, width, radius, time, units[6]; /* width and radius in lengths of the field; time: s of the field */
  float own[LTS_SOIL_SCALARS];                 /* scalars of the tool */
  double centres[LTS_SOIL_STRIPS], widths[LTS_SOIL_STRIPS];
  double inside[LTS_SOIL_INSIDE][2], inner_slope, reach; /* of a bucket, see `payload.Shape` */
  /* State. */
  int32_t started, writes, now, frame; /* writes: whether the tool moves the terrain */
  lts_pose pose;
  lts_soil_result result;
  lts_passage passage[2];
  lts_cells cells[2];
  /* Work space: the frame of a passage as the networks see it, */
  const lts_passage *seen; /* null: of none */
  int32_t sees_all, unused;
  float *bins[LTS_SOIL_CHANNELS]; /* [strips][n_bin] */
  float scalars[LTS_SOIL_STRIPS][LTS_SOIL_SCALARS];
  int32_t *gone; /* [cells] numbers of cells that are out of sight */
  float *risen;  /* [cells] */
  double *box;   /* about the cells in sight: what others have changed there */
  double *moved[2];    /* [cells of a row of the terrain] what slides to a row, and to the next one */
  unsigned char *kept; /* [cells of the terrain] 1 of those that stay as they are, while soil slides */
  double *under, *fresh, *first, *second; /* [n_bin], [strips][n_bin], [n_bin], [n_bin] */
  /* places, and rows on their way through a network. */
  lts_places *places;
  float *inputs, *sides, *bias, *out, *loads; /* loads [M][6] */
  float *a, *rows[2]; /* a: first layer of the load, of all members; rows: of the layers behind, in turn */
};

#define LTS_SOIL_ROW(soil, strip) ((size_t)(strip) * (size_t)(soil)->model->n_bin)

/* lts_soil_state.c. */
int lts_soil_check_started(const lts_soil *soil);

/* lts_soil_place.c. */
int lts_soil_unit_pose(const lts_pose *pose, lts_pose *out);
int lts_place_of(const lts_pose *pose, lts_place *out);
void lts_place_local(const lts_place *place, const double point[3], double out[3]);
/* `Place.laid` and `unlaid`; from and to may be one. */
void lts_place_laid(const lts_place *place, const double local[3], double out[3]);
void lts_place_unlaid(const lts_place *place, const double vector[3], double out[3]);
/* Lean, yaw and roll, rad. */
void lts_place_turns(const lts_place *place, const lts_pose *pose, double out[3]);

/* lts_soil_terrain.c: the distance from a point to the wall in a direction (x, z); the mean height of a
 * strip at u; whether a terrain can be one. */
int lts_terrain_usable(const lts_terrain *terrain);
double lts_terrain_wall(const lts_terrain *terrain, const double here[2], const double way[2]);
double lts_soil_read(const lts_soil *soil, const lts_terrain *terrain, const lts_place *place, int n_strip,
                     int strip, double u);
/* The strip below a place across and the share of the next one. */
int lts_soil_strip_at(const lts_soil *soil, int n_strip, double across, double *share);
/* The cells of a passage after its bins have moved; those that were seen before keep what is known. */
void lts_soil_look_around(lts_soil *soil, lts_passage *p);
/* Takes in what others have changed in sight: the terrain before the tool counts as changed by so much, and so do
 * the bins. LTS_ERROR_VALUE, and nothing changes: heights that are not finite. */
int lts_soil_meet(lts_soil *soil, lts_passage *p);
/* Writes the heights in sight into the terrain, where they are old. */
void lts_soil_write(lts_soil *soil);
/* Lets soil slide about n cells; those in sight of a passage stay as they are (null: all move). */
void lts_soil_settle(lts_soil *soil, const int32_t *cells, int32_t n, const lts_passage *kept);
/* The same, after all tools have written where another has in sight what this one has. */
int lts_soil_meet_others(lts_soil *soil);

/* lts_soil_sweep.c. */
double lts_soil_offset(const lts_soil_model *model, int bin);
double lts_soil_followed(const lts_soil_model *model, double origin, double tip);
double lts_soil_turn(const lts_soil *soil, const double change[3]);
void lts_soil_sweep_start(lts_soil *soil, lts_passage *p);
/* What falls short of all that was cut, of what is carried: (19). */
double lts_soil_owed(const lts_soil *soil, const lts_passage *p);
void lts_soil_shift(lts_soil *soil, lts_passage *p, double origin, int shift);
void lts_soil_advance(lts_soil *soil, lts_passage *p, const double pose[3], double turn, double dt);
/* Scalars and channels of a passage: about the tool, or all of them. */
void lts_soil_make_frame(lts_soil *soil, const lts_passage *p, int all);

/* lts_soil_passage.c: begins, goes on, copies. */
/* Of the strips under a tool: the first, and how many there are. */
int lts_soil_under(const lts_soil *soil, const lts_passage *p, int *first);
/* From one strip to all of them. */
int lts_soil_n_strip(const lts_soil *soil);
void lts_soil_take_all_strips(const lts_soil *soil, lts_passage *p);
/* The line through the outermost strips: its slope, and its height at the origin. */
double lts_soil_line(const lts_soil *soil, const lts_passage *p, double *height);
/* Rise per way of what slopes on the ground of a place. */
double lts_soil_whole_grade(const lts_place *place, double slope);
/* `Passage._ground`: whether its surface is even and slopes by more than the least; the place on that, or its own. */
int lts_soil_lay(const lts_soil *soil, const lts_passage *p, double least, lts_place *out);
int lts_soil_begin(lts_soil *soil, lts_passage *p, const lts_pose *pose, int set_down, const lts_place *place);
/* The coming pose as it is seen, and how far it is; LTS_ERROR_JUMP for one that is too far along. */
int lts_soil_reach(const lts_soil *soil, const lts_passage *p, const lts_pose *pose, double coming[3],
                   double change[3]);
int lts_soil_go(lts_soil *soil, lts_passage *p, const lts_pose *pose, double dt);
void lts_soil_copy(const lts_soil *soil, lts_passage *to, const lts_passage *from);
/* How high a tool that is seen somewhere is over the highest terrain before it that lies under it, and over the mean
 * of all in sight. */
double lts_soil_over(const lts_soil *soil, const lts_passage *p, const double seen[3]);
/* Whether anything has been cut, or dropped. */
int lts_soil_has_cut(const lts_soil *soil, const lts_passage *p);
/* Whether its tool has cut and is lifted since. */
int lts_soil_is_over(const lts_soil *soil, const lts_passage *p);
/* Whether its way is long, or its ground has another grade, and its tool has just cut farther than before. */
int lts_soil_is_due(const lts_soil *soil, const lts_passage *p);

/* lts_soil_table.c: which scalars differ from strip to strip; others are equal. */
void lts_soil_scalars_of_strip(const lts_soil_model *model, int out[LTS_SOIL_OF_STRIP]);
/* Inputs [n][ld] of places. offsets count from `base`; `other` are neighbours of strips, or null. */
void lts_soil_inputs(const lts_soil *soil, const lts_table *table, const lts_places *places,
                     int n_strip, const float *base, const int32_t *other, float *out, int ld);
/* Where channels are read: at u of a strip, or between two. */
typedef struct {
  size_t bin;          /* the lower one, of the lower strip */
  int has_next;        /* strip */
  float along, across; /* shares of the next bin, and of the next strip */
} lts_spot;
lts_spot lts_soil_spot(const lts_soil *soil, int n_strip, int strip, float share, float u);
float lts_soil_channel(const lts_soil *soil, int channel, const lts_spot *spot);
/* Of one channel: both at once. */
float lts_soil_channel_at(const lts_soil *soil, int channel, int n_strip, int strip, float share, float u);

/* lts_soil_load.c: one member of a network from x [rows, stride ldx] to `soil->out` [rows][LTS_PANEL]. */
void lts_soil_run(const lts_soil *soil, const lts_soil_network *net, int member, const float *x, int ldx, int rows);
/* Loads [members][6] of a passage; whether any is not 0. */
int lts_soil_find_loads(lts_soil *soil, const lts_passage *p, int members, float *out);
/* Height of the lowest part of a tool in the newest frame; the share of the load that acts on it: (22). */
double lts_soil_lowest_part(const lts_soil *soil);
double lts_soil_contact(lts_soil *soil, const lts_passage *p);

/* lts_soil_places.c: rise [n], or displacement [n][3], of a passage at places: u from the origin, height over the
 * level (of particles), across; m of the field. */
void lts_soil_find(lts_soil *soil, const lts_passage *p, int is_surface, size_t n,
                   void (*place)(const void *, size_t, double[3]), const void *of, float *out);


/* lts_soil_payload.c: soil that a bucket holds, and what weighs on it, m2 of the field; how far ahead of the edge its
 * middle lies; share of the load that it replaces. Twin of `passage.Held`. */
typedef struct {
  double area, weighs, middle, replaces;
} lts_held;
void lts_soil_fit_bucket(lts_soil *soil);
lts_held lts_soil_held(lts_soil *soil, const lts_passage *p);
/* What it takes up where it leaves the soil now. */
double lts_soil_scooped(lts_soil *soil, const lts_passage *p);
/* `Passage.give_and_take`. */
void lts_soil_give_and_take(lts_soil *soil, lts_passage *p, int keeps);

#endif
