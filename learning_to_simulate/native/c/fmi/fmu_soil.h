/* An FMU of a soil field: FMU_TOOLS tools on a terrain that begins level. */

/* Places at which heights are told, along and across, the tool in the middle. */
enum { FMU_ALONG = 9, FMU_ACROSS = 5 };

/* Further reals of a tool, of which the first is at 0, the second at VR_TOOL, and so on; then those of the ground. */
enum {
  VR_SPREAD = VR_OWN,
  VR_BOUND = VR_SPREAD + 6,
  VR_SINKAGE,
  VR_DRAWBAR,
  VR_HEIGHTS,
  VR_SHAPE = VR_HEIGHTS + FMU_ALONG * FMU_ACROSS, /* the first parameter: lts_soil_tool */
  VR_TOOL = VR_SHAPE + 7
};
enum {
  VR_GROUND = VR_TOOL * FMU_TOOLS,
  VR_SIZE = VR_GROUND, /* along x and z */
  VR_CELL = VR_GROUND + 2,
  VR_HEIGHT,
  VR_DEPTH,
  VR_FRICTION,
  VR_DENSITY,
  VR_GRAVITY,
  VR_GRID,
  N_REAL
};
enum { N_BOOLEAN = 4 }; /* of a tool: ok, ok_now, extrapolating, non_finite */

typedef struct {
  double h;            /* of the last step, s */
  int told[FMU_TOOLS]; /* status bits that have held since the start */
} fmu_own;

typedef struct {
  lts_terrain ground;
  void *memory[FMU_TOOLS];
  lts_soil *soil[FMU_TOOLS];
  int shown[FMU_TOOLS]; /* whether heights are those of now */
  double *built; /* reals that it was built for */
  char text[FMU_TOOLS][200], wrong[200];
} fmu_model;
