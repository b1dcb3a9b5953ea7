/* The kernels of each kind of machine, and which of them this one has. */
#include "lts_kernels.h"

#include <string.h>

#if defined(__GNUC__)
#define INLINE inline __attribute__((always_inline))
#define UNROLL _Pragma("GCC unroll 16")
#else
#define INLINE inline
#define UNROLL
#endif

static const float lts_zeros[LTS_PANEL] = {0.0f};

/* Any C99 compiler. A comparison that keeps NaN, so that a broken state stays visible. */
#define W 1
#define V float
#define TILE 1
#define NAME(name) scalar_##name
#define TARGET
#define LOAD(p) (*(p))
#define STORE(p, v) (*(p) = (v))
#define SET(v) (v)
#define ADD(a, b) ((a) + (b))
#define MUL(a, b) ((a) * (b))
#define MADD(a, b, c) ((a) * (b) + (c))
#define RELU(a) ((a) < 0.0f ? 0.0f : (a))
#define DIV(a, b) ((a) / (b))
#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))
#include "lts_kernels.inc"

/* Vectors of four: SSE2 of every x86-64, NEON of every AArch64. */
#if defined(__GNUC__)
typedef float v4 __attribute__((vector_size(16)));
typedef int32_t i4 __attribute__((vector_size(16)));
static INLINE v4 v4_load(const float *p) {
  v4 v;
  memcpy(&v, p, sizeof v);
  return v;
}
static INLINE void v4_store(float *p, v4 v) { memcpy(p, &v, sizeof v); }
static INLINE v4 v4_set(float x) { return (v4){x, x, x, x}; }
static INLINE v4 v4_relu(v4 a) { return (v4)((i4)a & ~(a < v4_set(0.0f))); }
static INLINE v4 v4_either(i4 which, v4 a, v4 b) { return (v4)(((i4)a & which) | ((i4)b & ~which)); }
static INLINE v4 v4_min(v4 a, v4 b) { return v4_either(a < b, a, b); }
static INLINE v4 v4_max(v4 a, v4 b) { return v4_either(a > b, a, b); }
#define W 4
#define V v4
#define TILE 3
#define NAME(name) vector4_##name
#define TARGET
#define LOAD(p) v4_load(p)
#define STORE(p, v) v4_store(p, v)
#define SET(v) v4_set(v)
#define ADD(a, b) ((a) + (b))
#define MUL(a, b) ((a) * (b))
#define MADD(a, b, c) ((a) * (b) + (c))
#define RELU(a) v4_relu(a)
#define DIV(a, b) ((a) / (b))
#define MIN(a, b) v4_min(a, b)
#define MAX(a, b) v4_max(a, b)
#include "lts_kernels.inc"
#endif

#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#if defined(__GNUC__)
#define TARGET __attribute__((target("avx2,fma")))
#else
#define TARGET
#endif
#define W 8
#define V __m256
#define TILE 6
#define NAME(name) avx2_##name
#define LOAD(p) _mm256_loadu_ps(p)
#define STORE(p, v) _mm256_storeu_ps(p, v)
#define SET(v) _mm256_set1_ps(v)
#define ADD(a, b) _mm256_add_ps(a, b)
#define MUL(a, b) _mm256_mul_ps(a, b)
#define MADD(a, b, c) _mm256_fmadd_ps(a, b, c)
#define RELU(a) _mm256_max_ps(_mm256_setzero_ps(), a) /* the second operand if that is NaN */
#define DIV(a, b) _mm256_div_ps(a, b)
#define MIN(a, b) _mm256_min_ps(a, b)
#define MAX(a, b) _mm256_max_ps(a, b)
#include "lts_kernels.inc"

#if defined(__GNUC__)
#define TARGET __attribute__((target("avx512f")))
#else
#define TARGET
#endif
#define W 16
#define V __m512
#define TILE 12
#define NAME(name) avx512_##name
#define LOAD(p) _mm512_loadu_ps(p)
#define STORE(p, v) _mm512_storeu_ps(p, v)
#define SET(v) _mm512_set1_ps(v)
#define ADD(a, b) _mm512_add_ps(a, b)
#define MUL(a, b) _mm512_mul_ps(a, b)
#define MADD(a, b, c) _mm512_fmadd_ps(a, b, c)
#define RELU(a) _mm512_max_ps(_mm512_setzero_ps(), a)
#define DIV(a, b) _mm512_div_ps(a, b)
#define MIN(a, b) _mm512_min_ps(a, b)
#define MAX(a, b) _mm512_max_ps(a, b)
#include "lts_kernels.inc"

#if defined(_MSC_VER) && !defined(__clang__)
#include <intrin.h>
static void cpuid(int leaf, unsigned int r[4]) { __cpuidex((int *)r, leaf, 0); }
static unsigned long long enabled_registers(void) { return _xgetbv(0); }
#else
#include <cpuid.h>
static void cpuid(int leaf, unsigned int r[4]) {
  if (!__get_cpuid_count((unsigned int)leaf, 0, &r[0], &r[1], &r[2], &r[3])) memset(r, 0, 16);
}
static unsigned long long enabled_registers(void) {
  unsigned int low, high;
  __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  return ((unsigned long long)high << 32) | low;
}
#endif

/* The fastest kind whose instructions the processor has and whose registers the system saves. */
static int best_x86(void) {
  unsigned int r[4];
  cpuid(1, r);
  const unsigned int fma = 1u << 12, osxsave = 1u << 27, avx = 1u << 28;
  if ((r[2] & (fma | osxsave | avx)) != (fma | osxsave | avx)) return LTS_VECTOR4;
  const unsigned long long saved = enabled_registers();
  cpuid(7, r);
  if ((saved & 0x06) != 0x06 || !((r[1] >> 5) & 1)) return LTS_VECTOR4;
  return (saved & 0xe6) == 0xe6 && ((r[1] >> 16) & 1) ? LTS_AVX512 : LTS_AVX2;
}
#endif

const lts_kernels *lts_find_kernels(int kind, int *found) {
  int best = LTS_SCALAR;
#if defined(__GNUC__)
  best = LTS_VECTOR4;
#endif
#if defined(__x86_64__) || defined(_M_X64)
  if (best_x86() > LTS_VECTOR4) best = best_x86();
#endif
  *found = kind == LTS_BEST ? best : kind;
  if (*found > best) return NULL;
  switch (*found) {
    case LTS_SCALAR: return &scalar_kernels;
#if defined(__GNUC__)
    case LTS_VECTOR4: return &vector4_kernels;
#endif
#if defined(__x86_64__) || defined(_M_X64)
    case LTS_AVX2: return &avx2_kernels;
    case LTS_AVX512: return &avx512_kernels;
#endif
    default: return NULL;
  }
}
