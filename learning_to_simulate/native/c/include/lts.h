/* Soil under a moving tool, one frame per call: the C interface of an exported model.
 *
 * The memory is the caller's, nothing is allocated, and there is no global state: an instance may be
 * used by one thread at a time, and instances share nothing but the constant model. Units are SI;
 * points and forces are in the world frame of the model's data; a frame is `dt` seconds.
 *
 * A call returns status bits (0 or more, `LTS_OK` is 0) or one of the errors below (negative). A call
 * that returns an error has changed nothing.
 *
 *   lts_init(&lts_model_of_export, memory, size, LTS_BEST, &soil);
 *   lts_start(soil, 0, NULL, NULL, NULL);
 *   for (;;) {
 *     lts_prepare(soil);                      // all that needs no pose: while there is time
 *     lts_frame_at(soil, &pose, &result);     // where the tool will be -> the force on it
 *   }
 */
#ifndef LTS_H
#define LTS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define LTS_ABI 1
#define LTS_HISTORY 6 /* frames that a recorded start has */

#if defined(_WIN32) && defined(LTS_SHARED)
#define LTS_API __declspec(dllexport)
#elif defined(__GNUC__)
#define LTS_API __attribute__((visibility("default")))
#else
#define LTS_API
#endif

/* A trained model: constants of a generated file. */
typedef struct lts_model lts_model;
/* One run of a model, somewhere in memory that the caller gave; must stay where it is. */
typedef struct lts_instance lts_instance;

/* Errors. */
enum {
  LTS_ERROR_NULL = -1,    /* a pointer that is needed is null */
  LTS_ERROR_MODEL = -2,   /* a model of another ABI */
  LTS_ERROR_MEMORY = -3,  /* too little memory, or memory that holds no instance */
  LTS_ERROR_CALL = -4,    /* not started, or a call that this model does not take */
  LTS_ERROR_VALUE = -5,   /* a number that is not finite, or out of its range */
  LTS_ERROR_STATE = -6,   /* saved bytes that are damaged or of another model */
  LTS_ERROR_JUMP = -7,    /* a pose that no tool reaches in this time */
  LTS_ERROR_PLACE = -8    /* a pose under the floor of the bed, or beyond the bins of the path */
};

/* Status bits of a frame. The first four say that the model is asked about what it never saw. */
enum {
  LTS_OK = 0,
  LTS_OUTSIDE_CONTEXT = 1, /* the scene's values (load, gravity, ...) */
  LTS_OUTSIDE_START = 2,   /* the start */
  LTS_OUTSIDE_POSE = 4,    /* a given point, or the extent of the given body */
  LTS_OUTSIDE_SPEED = 8,   /* the displacement of a given point, or of the body, in the frame */
  LTS_EXTRAPOLATING = 15,
  LTS_LEFT_BOUNDS = 16,    /* a predicted node left twice the hull of the training positions, or the
                              force is above twice the largest of the training runs */
  LTS_NON_FINITE = 32      /* a position or force is infinite or not a number */
};

/* How the body moves. */
enum { LTS_NO_BODY = 0, LTS_PRESCRIBED = 1, LTS_DRIVEN = 2, LTS_PREDICTED = 3 };

/* Which arithmetic. */
enum { LTS_BEST = -1, LTS_SCALAR = 0, LTS_VECTOR4 = 1, LTS_AVX2 = 2, LTS_AVX512 = 3 };

typedef struct {
  int32_t abi;
  int32_t n_rigid;   /* R points of the body that the model sees */
  int32_t n_modes;   /* r */
  int32_t n_soil;    /* N particles; 0 without a subspace */
  int32_t n_context; /* C values of the scene */
  int32_t n_start;   /* starts that came with the model */
  int32_t motion;    /* LTS_NO_BODY, ... */
  int32_t has_force;
  int32_t up_axis;
  double dt;           /* s per frame */
  const char *name;    /* of the scene */
  const char *digest;  /* sha256 of all numbers of the model, hexadecimal */
  const char *context_names; /* separated by commas */
} lts_description;

/* Position of the body's reference point, m, and rotation w, x, y, z from its attitude at the start. */
typedef struct {
  double position[3];
  double rotation[4];
} lts_pose;

/* Linear velocity of the reference point, m/s, and angular velocity, rad/s, both in the world. */
typedef struct {
  double linear[3];
  double angular[3];
} lts_twist;

typedef struct {
  double force[3];   /* on the body, N; 0 without a force */
  double point[3];   /* mean of the body's points, m; the force has no known line of action */
  int32_t frame;     /* its number; the first after a start is LTS_HISTORY */
  int32_t status;    /* bits of this frame */
} lts_result;

/* The worst that has held since the start, and since when. */
typedef struct {
  int32_t status; /* one or more bits of one kind; 0 while all is well */
  int32_t frame;
  int32_t node;   /* points of the body, then modes; -1: body, force or context as a whole */
  int32_t axis;   /* or index of the context; -1 */
  double value, low, high; /* low, high: the range of training */
} lts_judgement;

LTS_API int lts_describe(const lts_model *model, lts_description *out);
LTS_API const char *lts_error_text(int error);

/* Bytes that an instance needs, at any address; 0 for no usable model. */
LTS_API size_t lts_size(const lts_model *model);

/* Makes an instance. `kernel` is LTS_BEST or one of the others; one that this machine lacks is a
 * LTS_ERROR_VALUE. */
LTS_API int lts_init(const lts_model *model, void *memory, size_t size, int kernel,
                     lts_instance **out);
/* Which kernel an instance runs on. */
LTS_API int lts_kernel(const lts_instance *soil);

/* Starts from recorded frames: history [6][R + r][3] m, oldest first; context [C] or null. */
LTS_API int lts_reset(lts_instance *soil, const double *history, const double *context);

/* Starts from soil at rest.
 *   start: 0 .. n_start - 1; -1 takes the one whose context is nearest.
 *   pose: of the body (null: where it was in the training run); twist: its motion so far (null: at
 *   rest); context [C] (null: that of the start). */
LTS_API int lts_start(lts_instance *soil, int start, const lts_pose *pose, const lts_twist *twist,
                      const double *context);
/* Reference point and rotation of a start. */
LTS_API int lts_start_pose(const lts_model *model, int start, lts_pose *out);
/* Context [C] of a start. */
LTS_API int lts_start_context(const lts_model *model, int start, double *context);

/* Context [C] of the coming frame and those after it; outside the training runs that is noted at once
 * and returned, and is not in the status of the frame. */
LTS_API int lts_set_context(lts_instance *soil, const double *context);

/* Computes all of the coming frame that needs no pose; otherwise lts_frame does it. */
LTS_API int lts_prepare(lts_instance *soil);

/* One frame. points [R][3]: where the body will be, m; null where its motion is predicted or there
 * is none. Of a driven body the mean height is ignored. result may be null. */
LTS_API int lts_frame(lts_instance *soil, const double *points, lts_result *result);
/* The same for a body that was started by lts_start, by its coming pose. */
LTS_API int lts_frame_at(lts_instance *soil, const lts_pose *pose, lts_result *result);

/* A loop that is faster or slower than the model: `h` seconds, of which `pose` and `twist` hold at
 * the beginning. Every frame whose time the step reaches is computed, with the pose that the twist
 * leads to; between frames the force is held. Frames are never split. `result` is of the last frame,
 * with the status bits of all frames of the call. */
LTS_API int lts_advance(lts_instance *soil, double h, const lts_pose *pose, const lts_twist *twist,
                        lts_result *result);

/* Newest frame: modes [r][3] and points of the body [R][3], m. */
LTS_API int lts_modes(const lts_instance *soil, double *out);
LTS_API int lts_points(const lts_instance *soil, double *out);
/* Soil particles [N][3], m; `count` is N, so that a wrong buffer is refused. */
LTS_API int lts_particles(const lts_instance *soil, float *out, size_t count);

/* Highest particle centre in each cell of a grid across the up axis, m; NaN in empty cells.
 * Cells lie along the two other axes in their order, out[i * n[1] + j]; `origin` is the outer corner
 * of cell (0, 0). */
typedef struct {
  double origin[2];
  double cell; /* m */
  int32_t n[2];
} lts_grid;
LTS_API int lts_height_map(const lts_instance *soil, const lts_grid *grid, float *out);

LTS_API int lts_judge(const lts_instance *soil, lts_judgement *out);
/* The same in words, "" while all is well; `size` bytes of text, of which 200 are enough. */
LTS_API int lts_reason(const lts_instance *soil, char *text, size_t size);

/* State of an instance as bytes (any address), for rollback, copies and files. Bytes of another
 * model, ABI or byte order are refused. */
LTS_API size_t lts_state_size(const lts_model *model);
LTS_API int lts_save(const lts_instance *soil, void *bytes, size_t size);
LTS_API int lts_load(lts_instance *soil, const void *bytes, size_t size);
/* Gives `to` the state of `from`; both of the same model. */
LTS_API int lts_clone(lts_instance *to, const lts_instance *from);

#ifdef __cplusplus
}
#endif

#endif
