/* What the files share: how a function is exported, memory in one block, and vectors. */
#ifndef C3GS_MODULE_H
#define C3GS_MODULE_H
#include <stdint.h>
#include <stdlib.h>
#if defined(__wasm_simd128__)
#include <wasm_simd128.h>
#elif defined(__SSE2__)
#include <emmintrin.h>
#endif

#include "kernel.h"

/* name: in WebAssembly. A library has the name of the function. */
#if defined(__wasm__)
#define EXPORT(name) __attribute__((export_name(name)))
#else
#define EXPORT(name) KERNEL_API
#endif

/* Gives pieces of a block, or counts them while there is none. */
typedef struct {
    uint8_t *block;
    uint64_t used;
} pieces;

static inline void *piece(pieces *p, uint64_t count, uint64_t size)
{
    uint64_t at = p->used;
    p->used += (count * size + 15) / 16 * 16;
    return p->block ? p->block + at : NULL;
}

/* Vectors that GNU C has for any processor. */
typedef int16_t shorts __attribute__((vector_size(16), aligned(2), may_alias));
typedef int16_t few_shorts __attribute__((vector_size(8), aligned(2), may_alias));
typedef int32_t ints __attribute__((vector_size(16), aligned(4), may_alias));

/* The sums of the products of pairs. */
static inline ints pair_products(shorts a, shorts b)
{
#if defined(__wasm_simd128__)
    return (ints)wasm_i32x4_dot_i16x8((v128_t)a, (v128_t)b);
#elif defined(__SSE2__)
    return (ints)_mm_madd_epi16((__m128i)a, (__m128i)b);
#else
    /* The first of a pair is the low half. */
    ints x = (ints)a, y = (ints)b;
    return (x << 16 >> 16) * (y << 16 >> 16) + (x >> 16) * (y >> 16);
#endif
}

#endif
