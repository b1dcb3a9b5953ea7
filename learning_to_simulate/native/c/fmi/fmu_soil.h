/* An FMU of a soil field: FMU_TOOLS tools on a terrain that begins level. */

/* Places at which heights are told, along and across, the tool in the middle. */
enum { FMU_ALONG = 9, FMU_ACROSS = 5 };

/* Value references of the reals of a tool, the first at 0, the second at VR_TOOL, and so on; then those of the ground.
 * modelDescription.xml is written from the same order. */
enum {
  VR_POSITION = 0,
  VR_ROTATION = 3,
  VR_LINEAR = 7,
  VR_ANGULAR = 10,
  VR_POINT = 13, /* the first output */
  VR_FORCE = 16,
  VR_MOMENT = 19,
  VR_SPREAD = 22,
  VR_BOUND = 28,
  VR_SINKAGE = 29,
  VR_DRAWBAR = 30,
  VR_HEIGHTS = 31,
  VR_SHAPE = VR_HEIGHTS + FMU_ALONG * FMU_ACROSS, /* the first parameter: lts_soil_tool */
  VR_TOOL = VR_SHAPE + 7
};
enum {
  VR_GROUND = VR_TOOL * FMU_TOOLS,
  VR_SIZE = VR_GROUND, /* along x and z */
  VR_CELL = VR_GROUND + 2,
  VR_HEIGHT = VR_GROUND + 3,
  VR_DEPTH = VR_GROUND + 4,
  VR_FRICTION = VR_GROUND + 5,
  VR_DENSITY = VR_GROUND + 6,
  VR_GRAVITY = VR_GROUND + 7,
  VR_GRID = VR_GROUND + 8,
  N_REAL = VR_GROUND + 9
};
enum { N_BOOLEAN = 4 }; /* of a tool: ok, ok_now, extrapolating, non_finite */

typedef struct {
  fmu_phase now;
  int begun;                           /* whether tools and terrain are there */
  int told[FMU_TOOLS], unused;         /* status bits that have held since the start */
  double time, h;                      /* h: of the last step, s */
  double real[N_REAL];
} fmu_values;

typedef struct {
  lts_terrain ground;
  void *memory[FMU_TOOLS];
  lts_soil *soil[FMU_TOOLS];
  int shown[FMU_TOOLS]; /* whether heights are those of now */
  double *built; /* reals that it was built for */
  char text[FMU_TOOLS][200], wrong[200];
} fmu_model;
