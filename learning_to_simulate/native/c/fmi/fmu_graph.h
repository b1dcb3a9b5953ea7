/* An FMU of a graph, or of a network on the whole state. */
#define FMU_STATUS_BITS 6

/* Value references of the reals; modelDescription.xml is written from the same order. */
enum {
  VR_POSITION = 0,
  VR_ROTATION = 3,
  VR_LINEAR = 7,
  VR_ANGULAR = 10,
  VR_POINT = 13, /* the first output */
  VR_FORCE = 16,
  VR_MOMENT = 19,
  VR_SINKAGE = 22,
  VR_DRAWBAR = 23,
  VR_FRAME_TIME = 24,
  VR_CONTEXT = 25, /* fixed parameters */
  N_REAL = VR_CONTEXT + FMU_CONTEXT
};
enum { N_BOOLEAN = 4 }; /* ok, extrapolating, left_bounds, non_finite */

typedef struct {
  fmu_phase now;
  int begun;       /* whether the model has been started from the current values */
  int start, told; /* told: status bits that have held since the start */
  double time, first_height;
  double real[N_REAL];
} fmu_values;

typedef struct {
  void *memory;
  lts_instance *soil;
} fmu_model;
