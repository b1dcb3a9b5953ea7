/* Calls the C interface of a soil field in random order with good and hostile values, two tools on one terrain and
 * one on another; run under sanitizers. Usage: fuzz_soil SEED CALLS. Prints how often calls succeeded and failed. */
#define FUZZ_ODDS 60
#include "fuzz.h"

enum { TOOLS = 3, MOST = 40, ROWS = 60, COLUMNS = 40 };

int main(int argc, char **argv) {
  const lts_soil_model *model = &FUZZ_MODEL;
  lts_soil_description d;
  if (argc < 3 || lts_soil_describe(model, &d) < 0) return 2;
  seed = 88172645463325252ull + (uint64_t)atoll(argv[1]);
  const int is_wheel = d.kind == LTS_SOIL_WHEEL;
  const lts_soil_tool tool = {is_wheel ? 0.1 : 0.3, is_wheel ? 0.1 : 0.02, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  lts_terrain grounds[2];
  double *heights[2];
  for (int i = 0; i < 2; ++i) {
    heights[i] = malloc(ROWS * COLUMNS * sizeof **heights);
    for (int k = 0; k < ROWS * COLUMNS; ++k) heights[i][k] = i * 0.01 * sin(0.3 * k);
    const lts_terrain ground = {heights[i], {ROWS, COLUMNS}, i, 0,       {-0.9, -0.6}, {0.03, 0.03},
                                -0.4,       37.0,            1700.0, 9.81, 0};
    grounds[i] = ground;
  }
  /* At odd addresses, and exactly as long as asked for: sanitizers see one byte too many. */
  unsigned char *memory[TOOLS];
  lts_soil *soil[TOOLS];
  size_t size[TOOLS];
  for (int i = 0; i < TOOLS; ++i) {
    size[i] = lts_soil_size(model, &tool, &grounds[i / 2]);
    memory[i] = malloc(size[i] + 1);
    if (lts_soil_init(model, &tool, &grounds[i / 2], memory[i] + 1, size[i], LTS_BEST, &soil[i]) < 0) return 3;
  }
  float *bins = malloc(16 * (size_t)(d.n_bin * d.n_channel) * sizeof *bins), loads[6 * 8], risen[MOST];
  float scalars[16 * 64];
  double points[3 * MOST], place[9], loads6[6];
  lts_pose pose = {{0.0, 0.02, 0.0}, {1.0, 0.0, 0.0, 0.0}};
  long good = 0, bad = 0;
  for (long call = 0; call < atol(argv[2]); ++call) {
    const int which = (int)pick(TOOLS);
    lts_soil *one = soil[which];
    lts_pose p = pose;
    lts_soil_result result;
    char text[100];
    int code = 0;
    for (int i = 0; i < 3; ++i) p.position[i] = hostile(p.position[i] + 0.02 * ((int)pick(3) - 1));
    for (int i = 0; i < 4; ++i) p.rotation[i] = hostile(p.rotation[i]);
    for (int i = 0; i < 3 * MOST; ++i) points[i] = hostile(0.1 * (double)(i % 3) - 0.1);
    memset(&result, 0, sizeof result);
    result.now.axis = (int)pick(70) - 2;
    result.now.status = (int)pick(50);
    switch (pick(21)) {
      case 0:
        code = lts_soil_start(one, maybe(&p), maybe(&result));
        pose = code < 0 ? pose : p;
        break;
      case 1: code = lts_soil_propose(one, maybe(&p), hostile(0.02), maybe(&result)); break;
      case 2: code = lts_soil_newest(one, maybe(&result)); break;
      case 3: code = lts_soil_reason(one, &result.now, maybe(text), pick(sizeof text + 1)); break;
      case 4: code = lts_soil_place(one, maybe(place)); break;
      case 5: code = lts_terrain_update(maybe(&grounds[pick(2)])); break;
      case 6: code = lts_soil_anchor(one, maybe(&p), (int)pick(2)); break;
      case 7: code = lts_soil_follow(one, maybe(&p), hostile(0.02)); break;
      case 8: code = lts_soil_displacement(one, maybe(points), pick(MOST), maybe(points)); break;
      case 9: code = lts_soil_see(one, pick(2) ? bins : NULL, pick(2) ? scalars : NULL); break;
      case 10: code = lts_soil_loads(one, maybe(loads)); break;
      case 11: code = lts_soil_rise(one, maybe(points), pick(MOST), maybe(risen)); break;
      case 12: code = lts_soil_clone(one, maybe(soil[pick(TOOLS)])); break;
      case 13: code = lts_soil_members(one, (int)pick(5)); break;
      case 14: {
        heights[pick(2)][pick(ROWS * COLUMNS)] = pick(30) ? 0.1 * hostile(0.0) : hostile(0.0);
        code = lts_soil_reads(maybe(one), &p);
        break;
      }
      case 15: {
        lts_soil_tool other = tool;
        lts_terrain ground = grounds[0];
        other.width = hostile(other.width);
        ground.cell[0] = pick(2) ? ground.cell[0] : hostile(0.03);
        ground.n[0] = (int)pick(ROWS) - 1;
        if (pick(9)) { /* leaves and comes back */
          code = lts_soil_close(one);
          const int again = lts_soil_init(model, &tool, &grounds[which / 2], memory[which] + 1, size[which],
                                          LTS_BEST, &soil[which]);
          code = again < 0 ? again : code;
        } else {
          code = lts_soil_size(model, &other, &ground) ? 0 : -1;
        }
        break;
      }
      case 16: code = lts_soil_tangent(one, maybe(&p), hostile(0.02), maybe(points), hostile(1e-4), maybe(loads6)); break;
      case 17: {
        const size_t needed = lts_soil_state_size(one);
        unsigned char *bytes = malloc(needed);
        code = lts_soil_save(one, maybe(bytes), needed - pick(2));
        if (code >= 0) bytes[pick((unsigned)needed)] ^= pick(2) ? 1 : 0;
        if (code >= 0) code = lts_soil_restore(soil[pick(TOOLS)], bytes, needed - (pick(9) ? 0 : pick((unsigned)needed)));
        free(bytes);
        break;
      }
      default:
        code = lts_soil_step(one, maybe(&p), hostile(0.02), maybe(&result));
        if (code >= 0) pose = p;
    }
    *(code < 0 ? &bad : &good) += 1;
    if (pick(100) == 0) { /* all is well again */
      const lts_pose back = {{0.1, 0.05, 0.0}, {1.0, 0.0, 0.0, 0.0}};
      pose = back;
      for (int i = 0; i < 2; ++i) {
        for (int k = 0; k < ROWS * COLUMNS; ++k) heights[i][k] = i * 0.01 * sin(0.3 * k);
      }
      for (int i = 0; i < TOOLS; ++i) lts_soil_start(soil[i], &pose, NULL);
    }
  }
  for (int i = 0; i < TOOLS; ++i) {
    lts_soil_close(soil[i]);
    free(memory[i]);
  }
  for (int i = 0; i < 2; ++i) free(heights[i]);
  free(bins);
  printf("%ld good, %ld refused\n", good, bad);
  return 0;
}
