/* The state of an instance, without the heights of its terrain: as bytes, and in another instance. */
#include <string.h>

#include "lts_soil_internal.h"

/* What comes first in bytes; then the rows of the passage, and what is known of its cells. */
typedef struct {
  int32_t members, started, writes, frame, n_cells, unused;
  lts_soil_tool tool;
  int32_t n[2];
  lts_pose pose;
  lts_soil_result result;
  lts_way way;
} saved_soil;

enum { N_PARTS = LTS_SOIL_ROWS + 5 };

/* The other parts of a passage and its cells, and their sizes: whole words of 8 bytes. Returns that of all bytes. */
static size_t find_parts(const lts_soil *soil, const lts_passage *p, const lts_cells *c, int n_strip, int32_t n_cells,
                         void *parts[N_PARTS], size_t sizes[N_PARTS]) {
  void *const found[N_PARTS] = {p->surface, p->profile, p->last, p->area_before, p->struck,
                                c->number,  c->before,  c->left, c->u,           c->across};
  size_t all = sizeof(saved_soil);
  for (int i = 0; i < N_PARTS; ++i) {
    parts[i] = found[i];
    sizes[i] = sizeof(double) * (i < LTS_SOIL_ROWS ? LTS_SOIL_ROW(soil, n_strip) : (size_t)n_cells);
    if (i == LTS_SOIL_ROWS) sizes[i] = ((size_t)n_cells + 1) / 2 * sizeof(double);
    all += sizes[i];
  }
  return all;
}

static size_t parts_of(const lts_soil *soil, void *parts[N_PARTS], size_t sizes[N_PARTS]) {
  const lts_passage *p = &soil->passage[soil->now];
  const lts_cells *c = &soil->cells[p->s.cells];
  return find_parts(soil, p, c, soil->started ? p->s.n_strip : 0, soil->started ? c->n : 0, parts, sizes);
}

static saved_soil head_of(const lts_soil *soil) {
  const lts_passage *p = &soil->passage[soil->now];
  saved_soil head;
  memset(&head, 0, sizeof head);
  head.members = soil->members;
  head.started = soil->started;
  head.writes = soil->writes;
  head.frame = soil->frame;
  head.n_cells = soil->started ? soil->cells[p->s.cells].n : 0;
  head.tool = soil->tool;
  memcpy(head.n, soil->terrain->n, sizeof head.n);
  head.pose = soil->pose;
  head.result = soil->result;
  head.way = p->s;
  return head;
}

/* Takes a head over, whose other parts are in the first passage and cells. */
static void take_head(lts_soil *soil, const saved_soil *head) {
  soil->members = head->members;
  soil->started = head->started;
  soil->writes = head->writes;
  soil->frame = head->frame;
  soil->pose = head->pose;
  soil->result = head->result;
  soil->passage[0].s = head->way;
  soil->passage[0].s.cells = 0;
  soil->cells[0].n = head->n_cells;
  soil->now = 0;
  soil->seen = NULL;
}

size_t lts_soil_state_size(const lts_soil *soil) {
  void *parts[N_PARTS];
  size_t sizes[N_PARTS];
  if (lts_check(soil) < 0) return 0;
  return LTS_HEADER_SIZE + parts_of(soil, parts, sizes);
}

int lts_soil_save(const lts_soil *soil, void *bytes, size_t size) {
  LTS_TRY(lts_check(soil));
  if (!bytes) return LTS_ERROR_NULL;
  if (size < lts_soil_state_size(soil)) return LTS_ERROR_MEMORY;
  void *parts[N_PARTS];
  size_t sizes[N_PARTS];
  const size_t n = parts_of(soil, parts, sizes);
  const saved_soil head = head_of(soil);
  char *to = (char *)bytes + LTS_HEADER_SIZE;
  memcpy(to, &head, sizeof head);
  to += sizeof head;
  for (int i = 0; i < N_PARTS; ++i) {
    memcpy(to, parts[i], sizes[i]);
    to += sizes[i];
  }
  return lts_write_state(soil->model->digest, (char *)bytes + LTS_HEADER_SIZE, n, bytes, size);
}

int lts_soil_restore(lts_soil *soil, const void *bytes, size_t size) {
  LTS_TRY(lts_check(soil));
  if (!bytes) return LTS_ERROR_NULL;
  const lts_terrain *t = soil->terrain;
  const char *from = (const char *)bytes + LTS_HEADER_SIZE;
  saved_soil head;
  if (size < LTS_HEADER_SIZE + sizeof head) return LTS_ERROR_STATE;
  memcpy(&head, from, sizeof head);
  const int n_strip = head.started ? head.way.n_strip : 0;
  if (head.started ? n_strip != 1 && n_strip != lts_soil_n_strip(soil) : head.n_cells != 0) return LTS_ERROR_STATE;
  if (head.n_cells < 0 || head.n_cells > soil->most_cells || memcmp(&head.tool, &soil->tool, sizeof head.tool) ||
      memcmp(head.n, t->n, sizeof head.n) || head.members < 1 || head.members > soil->model->n_member) {
    return LTS_ERROR_STATE;
  }
  void *parts[N_PARTS];
  size_t sizes[N_PARTS];
  const size_t n = find_parts(soil, &soil->passage[0], &soil->cells[0], n_strip, head.n_cells, parts, sizes);
  LTS_TRY(lts_check_state(soil->model->digest, bytes, size, n));
  const size_t before = sizeof head + LTS_SOIL_ROWS * LTS_SOIL_ROW(soil, n_strip) * sizeof(double);
  for (int32_t k = 0; k < head.n_cells; ++k) {
    int32_t number;
    memcpy(&number, from + before + (size_t)k * sizeof number, sizeof number);
    if (number < 0 || number >= t->n[0] * t->n[1]) return LTS_ERROR_STATE;
  }
  from += sizeof head;
  for (int i = 0; i < N_PARTS; ++i) {
    memcpy(parts[i], from, sizes[i]);
    from += sizes[i];
  }
  take_head(soil, &head);
  return LTS_OK;
}

int lts_soil_clone(lts_soil *to, const lts_soil *from) {
  LTS_TRY(lts_check(to));
  LTS_TRY(lts_check(from));
  const lts_terrain *one = to->terrain, *other = from->terrain;
  if (strcmp(to->model->digest, from->model->digest)) return LTS_ERROR_STATE;
  if (memcmp(&to->tool, &from->tool, sizeof to->tool) || one == other ||
      memcmp(one->n, other->n, sizeof one->n) || memcmp(one->cell, other->cell, sizeof one->cell) ||
      memcmp(one->corner, other->corner, sizeof one->corner)) {
    return LTS_ERROR_VALUE;
  }
  void *theirs[N_PARTS], *ours[N_PARTS];
  size_t sizes[N_PARTS];
  const saved_soil head = head_of(from);
  parts_of(from, theirs, sizes);
  find_parts(to, &to->passage[0], &to->cells[0], head.started ? head.way.n_strip : 0, head.n_cells, ours, sizes);
  for (int i = 0; i < N_PARTS; ++i) memcpy(ours[i], theirs[i], sizes[i]);
  take_head(to, &head);
  return LTS_OK;
}
