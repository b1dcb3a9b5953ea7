/* Calls the C interface in random order with good and hostile values; run under sanitizers.
 * Usage: fuzz_calls SEED CALLS. Prints how often calls succeeded and failed. */
#define FUZZ_ODDS 40
#include "fuzz.h"

int main(int argc, char **argv) {
  const lts_model *model = &FUZZ_MODEL;
  lts_description d;
  if (argc < 3 || lts_describe(model, &d) < 0) return 2;
  seed = 88172645463325252ull + (uint64_t)atoll(argv[1]);
  const long calls = atol(argv[2]);
  const size_t size = lts_size(model), state_size = lts_state_size(model);
  const size_t n_node = (size_t)(d.n_rigid + d.n_modes);
  /* Exact sizes, so that the sanitizer sees every byte beyond. An odd address on purpose. */
  char *room[2] = {malloc(size + 1), malloc(size + 1)};
  unsigned char *state = malloc(state_size + 1);
  double *nodes = malloc(LTS_HISTORY * 3 * n_node * sizeof(double));
  double *out = malloc(3 * n_node * sizeof(double));
  double *context = malloc(((size_t)d.n_context + 1) * sizeof(double));
  float *particles = malloc(3 * (size_t)d.n_soil * sizeof(float) + 1);
  float heights[35];
  lts_instance *soil[2] = {NULL, NULL};
  lts_pose start;
  lts_start_pose(model, 0, &start);
  lts_init(model, room[0] + 1, size, LTS_BEST, &soil[0]);
  lts_init(model, room[1], size, LTS_SCALAR, &soil[1]);
  memset(state, 0, state_size + 1);
  long good = 0, refused = 0;
  for (long k = 0; k < calls; ++k) {
    lts_instance *s = (lts_instance *)maybe(soil[pick(2)]);
    lts_pose pose = start;
    lts_twist twist;
    lts_result result;
    lts_judgement worst;
    char text[100];
    lts_grid grid = {{hostile(0.0), hostile(0.0)}, hostile(0.1), {5, 7}};
    int code = 0;
    for (int i = 0; i < 3; ++i) {
      pose.position[i] = hostile(pose.position[i]);
      twist.linear[i] = hostile(0.0);
      twist.angular[i] = hostile(0.0);
    }
    for (int i = 0; i < 4; ++i) pose.rotation[i] = hostile(pose.rotation[i]);
    for (int i = 0; i < d.n_context; ++i) context[i] = hostile(10.0);
    switch (pick(17)) {
      case 0:
        for (size_t i = 0; i < LTS_HISTORY * 3 * n_node; ++i) {
          nodes[i] = pick(2000) ? (double)pick(1000) * 1e-3 : hostile(0.0);
        }
        code = lts_reset(s, (double *)maybe(nodes), (double *)maybe(context));
        break;
      case 1:
        code = lts_start(s, (int)pick(5) - 2, (lts_pose *)maybe(&pose), (lts_twist *)maybe(&twist),
                         pick(2) ? context : NULL);
        break;
      case 2: code = lts_prepare(s); break;
      case 3:
      case 4:
        for (size_t i = 0; i < 3 * (size_t)d.n_rigid; ++i) nodes[i] = hostile(start.position[i % 3]);
        code = lts_frame(s, (double *)maybe(nodes), (lts_result *)maybe(&result));
        break;
      case 5:
      case 6: code = lts_frame_at(s, (lts_pose *)maybe(&pose), (lts_result *)maybe(&result)); break;
      case 7:
        code = lts_advance(s, pick(2) ? d.dt * 0.4 * pick(8) : hostile(d.dt), &pose,
                           (lts_twist *)maybe(&twist), (lts_result *)maybe(&result));
        break;
      case 8: code = lts_modes(s, (double *)maybe(out)); break;
      case 9: code = lts_points(s, (double *)maybe(out)); break;
      case 10:
        code = lts_particles(s, (float *)maybe(particles), (size_t)d.n_soil + (pick(20) == 0));
        break;
      case 11:
        if (pick(10) == 0) grid.n[0] = (int)pick(5) - 3;
        if (grid.n[0] <= 5) code = lts_height_map(s, (lts_grid *)maybe(&grid), heights);
        break;
      case 12:
        code = pick(2) ? lts_judge(s, (lts_judgement *)maybe(&worst))
                       : lts_reason(s, (char *)maybe(text), pick(sizeof text + 1));
        break;
      case 13: code = lts_save(s, maybe(state + 1), state_size - (pick(10) == 0)); break;
      case 14: /* from an odd address, sometimes damaged */
        if (pick(4) == 0) state[1 + pick((unsigned)state_size)] ^= (unsigned char)(1u << pick(8));
        code = lts_load(s, maybe(state + 1), state_size - (pick(20) == 0));
        break;
      case 15: code = lts_clone(s, (lts_instance *)maybe(soil[pick(2)])); break;
      default:
        code = pick(50) ? lts_kernel(s)
                        : lts_init((const lts_model *)maybe((void *)(uintptr_t)model),
                                   maybe(room[0] + 1), size - (pick(3) == 0), (int)pick(6) - 2,
                                   &soil[0]);
    }
    if (code < LTS_ERROR_STATE || code > 63) return 3;
    *(code < 0 ? &refused : &good) += 1;
  }
  printf("%ld good %ld refused\n", good, refused);
  free(room[0]);
  free(room[1]);
  free(state);
  free(nodes);
  free(out);
  free(context);
  free(particles);
  return 0;
}
