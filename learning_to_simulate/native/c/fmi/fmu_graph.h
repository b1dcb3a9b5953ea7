/* An FMU of a graph, or of a network on the whole state. */
#define FMU_STATUS_BITS 6

/* Further reals. */
enum {
  VR_SINKAGE = VR_OWN,
  VR_DRAWBAR,
  VR_FRAME_TIME,
  VR_CONTEXT, /* fixed parameters */
  N_REAL = VR_CONTEXT + FMU_CONTEXT
};
enum { N_BOOLEAN = 4 }; /* ok, extrapolating, left_bounds, non_finite */

typedef struct {
  int start, told; /* told: status bits that have held since the start */
  double first_height;
} fmu_own;

typedef struct {
  void *memory;
  lts_instance *soil;
} fmu_model;
