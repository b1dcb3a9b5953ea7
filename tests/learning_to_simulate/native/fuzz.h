/* What both fuzzers share: numbers without end from a seed, hostile values, pointers that may be null. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include FUZZ_HEADER

static uint64_t seed;
static unsigned pick(unsigned n) { /* xorshift */
  seed ^= seed << 13;
  seed ^= seed >> 7;
  seed ^= seed << 17;
  return (unsigned)(seed >> 33) % n;
}

/* Near the usual value, and once in FUZZ_ODDS times none that a tool has. */
static double hostile(double usual) {
  const double bad[] = {NAN, INFINITY, -INFINITY, 1e300, -1e300, 1e30, 5e-324, 0.0, -1.0, 1e9};
  return pick(FUZZ_ODDS) ? usual + 1e-3 * ((double)pick(1000) / 500.0 - 1.0) : bad[pick(10)];
}

static void *maybe(void *p) { return pick(30) ? p : NULL; }
