/* Calls the C interface of a swept field in random order with good and hostile values; run under
 * sanitizers. Usage: fuzz_field SEED CALLS. Prints how often calls succeeded and failed. */
#define FUZZ_ODDS 60
#include "fuzz.h"

int main(int argc, char **argv) {
  const lts_field_model *model = &FUZZ_MODEL;
  lts_field_description d;
  if (argc < 3 || lts_field_describe(model, &d) < 0) return 2;
  seed = 88172645463325252ull + (uint64_t)atoll(argv[1]);
  const size_t size = lts_field_size(model), n = (size_t)d.n_soil, most = 1u << 20;
  /* At odd addresses, and exactly as long as asked for: sanitizers see one byte too many. */
  unsigned char *memory[2], *saved = malloc(most);
  lts_field *soil[2];
  float *points = malloc(3 * n * sizeof *points), *heights = malloc(64 * 64 * sizeof *heights);
  for (int i = 0; i < 2; ++i) {
    memory[i] = malloc(size + 1);
    if (lts_field_init(model, memory[i] + 1, size, LTS_BEST, &soil[i]) < 0) return 3;
  }
  const int is_wheel = d.tool == LTS_FIELD_WHEEL;
  size_t kept = 0;
  long good = 0, bad = 0;
  lts_pose pose = {{d.start[0], d.start[1], d.start[2]}, {1.0, 0.0, 0.0, 0.0}};
  double usual[8] = {0.0};
  lts_field_start_context(model, 0, usual);
  for (long call = 0; call < atol(argv[2]); ++call) {
    lts_field *one = soil[pick(2)];
    lts_pose p = pose;
    lts_twist t = {{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}};
    lts_field_result result;
    lts_judgement judged;
    char text[100];
    lts_grid grid = {{hostile(0.0), hostile(0.0)}, hostile(0.02), {0, 0}};
    double places[8], heights_of[8], context[8];
    int code = 0;
    for (int i = 0; i < 8; ++i) context[i] = hostile(usual[i]);
    for (int i = 0; i < 2; ++i) grid.n[i] = (int)pick(66) - 1;
    for (int i = 0; i < 3; ++i) {
      p.position[i] = hostile(p.position[i]);
      t.linear[i] = hostile(0.0);
      t.angular[i] = hostile(0.0);
    }
    for (int i = 0; i < 4; ++i) p.rotation[i] = hostile(p.rotation[i]);
    for (int i = 0; i < 8; ++i) {
      places[i] = hostile(0.1 * i);
      heights_of[i] = hostile(d.level);
    }
    switch (pick(16)) {
      case 0: {
        lts_field_bed bed = {maybe(places), maybe(heights_of), (int)pick(10) - 1, maybe(points)};
        if (bed.n > 8) bed.n = 8;
        for (size_t i = 0; !pick(5) && i < 3 * n; ++i) points[i] = (float)hostile(0.3);
        if (is_wheel && pick(20)) {
          code = lts_field_start_wheel(one, (int)pick(4) - 2, pick(2) ? &p : NULL, maybe(&t),
                                       pick(2) ? &bed : NULL, pick(2) ? context : NULL);
        } else {
          code = lts_field_start(one, maybe(&p), maybe(&t), pick(2) ? &bed : NULL, hostile(0.0));
        }
        pose = code < 0 ? pose : p;
        break;
      }
      case 1: code = lts_field_renew(maybe(one)); break;
      case 2:
        code = lts_field_advance(one, hostile(0.01), maybe(&p), maybe(&t), maybe(&result));
        break;
      case 3: code = lts_field_particles(one, maybe(points), pick(9) ? n : n + 1); break;
      case 4: {
        const int fits = grid.n[0] <= 64 && grid.n[1] <= 64;
        code = fits ? lts_field_height_map(one, maybe(&grid), maybe(heights)) : 0;
        break;
      }
      case 5:
        code = pick(2) ? lts_field_judge(one, maybe(&judged))
                       : lts_field_reason(one, maybe(text), pick(sizeof text + 1));
        break;
      case 6: code = lts_field_moving(maybe(one)); break;
      case 7:
        kept = lts_field_state_size(one);
        code = lts_field_save(one, maybe(saved), pick(9) ? kept : kept - 1);
        break;
      case 8: {
        if (!kept) break;
        unsigned char *copy = malloc(kept);
        memcpy(copy, saved, kept);
        if (!pick(3)) copy[pick((unsigned)kept)] ^= (unsigned char)(1 + pick(255));
        code = lts_field_load(one, maybe(copy), kept);
        free(copy);
        break;
      }
      case 9: code = lts_field_clone(one, maybe(soil[pick(2)])); break;
      case 10: code = lts_field_members(one, (int)pick(5), (int)pick(5)); break;
      case 11: {
        lts_pose at;
        code = lts_field_start_pose(model, (int)pick(5) - 2, maybe(&at));
        if (code >= 0) code = lts_field_start_context(model, (int)pick(5) - 2, maybe(context));
        if (code >= 0) code = lts_field_context(one, maybe(context));
        if (code >= 0) code = lts_field_newest(one, maybe(&result));
        break;
      }
      case 12: code = lts_field_set_context(one, pick(9) ? usual : maybe(context)); break;
      default:
        code = lts_field_frame(one, maybe(&p), hostile(0.02), maybe(&result));
        if (code >= 0) pose = p;
    }
    *(code < 0 ? &bad : &good) += 1;
    if (pick(200) == 0) {
      const lts_pose back = {{d.start[0], d.start[1] - 0.03, d.start[2]}, {1.0, 0.0, 0.0, 0.0}};
      pose = back;
      if (is_wheel) {
        lts_field_start_pose(model, 0, &pose);
        lts_field_start_wheel(one, 0, NULL, NULL, NULL, NULL);
      } else {
        lts_field_start(one, &pose, NULL, NULL, 0.0);
      }
    }
  }
  for (int i = 0; i < 2; ++i) free(memory[i]);
  free(saved);
  free(points);
  free(heights);
  printf("%ld good, %ld refused\n", good, bad);
  return 0;
}
