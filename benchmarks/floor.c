/* The floor of decoding: work that every decoder of these networks and symbols must do, in the fastest way of this
 * processor. It is not a decoder.
 *
 * - products: the products of all layers, in float32 or in int16 pairs, without rounding, clamps or model selection.
 * - decode: one pass of interleaved rANS, with the model of each symbol given.
 * - output: one pass that writes the bytes of all values to new memory.
 *
 * encode makes the stream that decode reads. It is not measured.
 */
#define _GNU_SOURCE
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

enum { LANES = 64, PRECISION = 14, TOTAL = 1 << PRECISION, STATE_MIN = 1 << 16, FIRST_BITS = 8 };

/* ---------------------------------------------------------------- products */

/* A block of anchors stays in the registers: VECTORS vectors of anchors, for OUTPUTS outputs at once. */
#if defined(__AVX512F__)
enum { BYTES = 64, VECTORS = 4, OUTPUTS = 6 };
#elif defined(__AVX2__)
enum { BYTES = 32, VECTORS = 2, OUTPUTS = 6 };
#else
enum { BYTES = 16, VECTORS = 4, OUTPUTS = 6 };
#endif
enum { WIDTH = BYTES / 4, BLOCK = VECTORS * WIDTH };
typedef float floats __attribute__((vector_size(BYTES)));
typedef int32_t ints __attribute__((vector_size(BYTES)));

/* Adds the two products of each int16 pair to an int32. */
#if defined(__AVX512VNNI__) && defined(__AVX512F__)
#define PAIRS 1
static inline ints add_pairs(ints sum, ints x, ints w)
{
    return (ints)_mm512_dpwssd_epi32((__m512i)sum, (__m512i)x, (__m512i)w);
}
#elif defined(__AVX512BW__)
#define PAIRS 1
static inline ints add_pairs(ints sum, ints x, ints w)
{
    return sum + (ints)_mm512_madd_epi16((__m512i)x, (__m512i)w);
}
#elif defined(__AVX512F__)
#define PAIRS 0
#elif defined(__AVXVNNI__)
#define PAIRS 1
static inline ints add_pairs(ints sum, ints x, ints w)
{
    return (ints)_mm256_dpwssd_avx_epi32((__m256i)sum, (__m256i)x, (__m256i)w);
}
#elif defined(__AVX2__)
#define PAIRS 1
static inline ints add_pairs(ints sum, ints x, ints w)
{
    return sum + (ints)_mm256_madd_epi16((__m256i)x, (__m256i)w);
}
#else
#define PAIRS 0
#endif

int has_pairs(void) { return PAIRS; }

/* One layer for one block of anchors. x: [steps][BLOCK]; w: [outputs][steps]; y: [outputs][BLOCK]. */
#define LAYER(name, vector, scalar, ADD)                                                                               \
    static void name(const vector *x, const scalar *w, vector *y, int steps, int outputs)                              \
    {                                                                                                                  \
        for (int o = 0; o < outputs; o += OUTPUTS) {                                                                   \
            const scalar *row[OUTPUTS];                                                                                \
            vector sum[OUTPUTS][VECTORS];                                                                              \
            for (int a = 0; a < OUTPUTS; a++) {                                                                        \
                row[a] = w + (size_t)(o + a < outputs ? o + a : outputs - 1) * (size_t)steps;                          \
                for (int v = 0; v < VECTORS; v++)                                                                      \
                    sum[a][v] = (vector){0};                                                                           \
            }                                                                                                          \
            for (int i = 0; i < steps; i++)                                                                            \
                for (int a = 0; a < OUTPUTS; a++) {                                                                    \
                    vector factor = row[a][i] - (vector){0};                                                           \
                    for (int v = 0; v < VECTORS; v++)                                                                  \
                        sum[a][v] = ADD(sum[a][v], x[i * VECTORS + v], factor);                                        \
                }                                                                                                      \
            for (int a = 0; a < OUTPUTS && o + a < outputs; a++)                                                       \
                memcpy(y + (size_t)(o + a) * VECTORS, sum[a], sizeof sum[a]);                                          \
        }                                                                                                              \
    }

#define ADD_FLOATS(sum, x, w) ((sum) + (x) * (w))
LAYER(layer_of_floats, floats, float, ADD_FLOATS)
#if PAIRS
LAYER(layer_of_pairs, ints, int32_t, add_pairs)
#endif

/* shapes: rows, inputs and outputs of each layer. pairs: whether to use int16 pairs. Returns 0, or 1 without memory. */
int products(const int64_t *shapes, int64_t layers, int pairs)
{
    int failed = 0;
    for (int64_t l = 0; l < layers && !failed; l++) {
        int64_t rows = shapes[3 * l];
        int inputs = (int)shapes[3 * l + 1], outputs = (int)shapes[3 * l + 2];
        int steps = pairs ? (inputs + 1) / 2 : inputs;
        size_t x_bytes = (size_t)(steps + 1) * VECTORS * BYTES, y_bytes = (size_t)outputs * VECTORS * BYTES;
        size_t w_bytes = (size_t)(outputs * steps + BYTES) / BYTES * BYTES * 4;
        void *x = aligned_alloc(BYTES, x_bytes), *y = aligned_alloc(BYTES, y_bytes), *w = aligned_alloc(BYTES, w_bytes);
        failed = !x || !y || !w;
        if (!failed) {
            memset(x, 0, x_bytes);
            memset(w, 0, w_bytes);
            for (int64_t row = 0; row < rows; row += BLOCK) {
                /* The compiler must not know that each block gives the same. */
                __asm__ volatile("" : : "r"(x), "r"(w) : "memory");
#if PAIRS
                if (pairs)
                    layer_of_pairs(x, w, y, steps, outputs);
                else
#endif
                    layer_of_floats(x, w, y, steps, outputs);
                __asm__ volatile("" : : "r"(y) : "memory");
            }
        }
        free(x);
        free(y);
        free(w);
    }
    return failed;
}

/* ---------------------------------------------------------------- rANS */

/* The models of a stream, in sequence.
 * offset: where the symbols of each model start. entry: of each symbol its low slot, and its frequency above 16 bits.
 * first: of each model and the top bits of a slot, the first symbol that the slot can mean.
 *   3 bytes more are readable. */
struct models {
    const uint32_t *offset, *entry;
    const uint8_t *first;
};

/* Returns the number of words, which are at the end of `words`. It has room for one word per symbol. */
int64_t encode(const struct models *m, const uint16_t *model, const uint8_t *symbol, int64_t count, uint32_t *state,
               uint16_t *words)
{
    int64_t at = count;
    for (int lane = 0; lane < LANES; lane++)
        state[lane] = STATE_MIN;
    for (int64_t i = count; i-- > 0;) {
        uint32_t entry = m->entry[m->offset[model[i]] + symbol[i]], frequency = entry >> 16, x = state[i % LANES];
        if (x >> (32 - PRECISION) >= frequency) {
            words[--at] = (uint16_t)x;
            x >>= 16;
        }
        state[i % LANES] = (x / frequency << PRECISION) + x % frequency + (entry & 0xFFFF);
    }
    return count - at;
}

/* Steps one lane. */
static inline uint8_t decode_one(const struct models *m, uint32_t model, uint32_t *state, const uint16_t **word)
{
    uint32_t x = *state, slot = x & (TOTAL - 1), offset = m->offset[model];
    uint32_t symbol = m->first[model << FIRST_BITS | slot >> (PRECISION - FIRST_BITS)];
    uint32_t entry = m->entry[offset + symbol];
    while ((entry & 0xFFFF) + (entry >> 16) <= slot)
        entry = m->entry[offset + ++symbol];
    x = (entry >> 16) * (x >> PRECISION) + slot - (entry & 0xFFFF);
    if (x < STATE_MIN)
        x = x << 16 | *(*word)++;
    *state = x;
    return (uint8_t)symbol;
}

#if defined(__AVX512F__) && defined(__AVX512BW__)
/* Steps 16 lanes. Returns the number of words read. 16 more words are readable. */
static inline unsigned decode_vector(const struct models *m, const uint16_t *model, uint8_t *symbol, uint32_t *state,
                                     const uint16_t *word)
{
    const __m512i low16 = _mm512_set1_epi32(0xFFFF), one = _mm512_set1_epi32(1);
    __m512i x = _mm512_loadu_si512(state), id = _mm512_cvtepu16_epi32(_mm256_loadu_si256((const void *)model));
    __m512i slot = _mm512_and_si512(x, _mm512_set1_epi32(TOTAL - 1));
    __m512i key = _mm512_or_si512(_mm512_slli_epi32(id, FIRST_BITS), _mm512_srli_epi32(slot, PRECISION - FIRST_BITS));
    __m512i j = _mm512_and_si512(_mm512_i32gather_epi32(key, m->first, 1), _mm512_set1_epi32(255));
    __m512i at = _mm512_add_epi32(_mm512_i32gather_epi32(id, m->offset, 4), j);
    __m512i entry = _mm512_i32gather_epi32(at, m->entry, 4), low, frequency;
    for (;;) {
        low = _mm512_and_si512(entry, low16);
        frequency = _mm512_srli_epi32(entry, 16);
        __mmask16 late = _mm512_cmple_epu32_mask(_mm512_add_epi32(low, frequency), slot);
        if (!late)
            break;
        j = _mm512_mask_add_epi32(j, late, j, one);
        at = _mm512_mask_add_epi32(at, late, at, one);
        entry = _mm512_mask_i32gather_epi32(entry, late, at, m->entry, 4);
    }
    x = _mm512_add_epi32(_mm512_mullo_epi32(frequency, _mm512_srli_epi32(x, PRECISION)), _mm512_sub_epi32(slot, low));
    __mmask16 hungry = _mm512_cmplt_epu32_mask(x, _mm512_set1_epi32(STATE_MIN));
    __m512i more = _mm512_cvtepu16_epi32(_mm256_loadu_si256((const void *)word));
    more = _mm512_maskz_expand_epi32(hungry, more);
    _mm512_storeu_si512(state, _mm512_mask_or_epi32(x, hungry, _mm512_slli_epi32(x, 16), more));
    _mm_storeu_si128((void *)symbol, _mm512_cvtepi32_epi8(j));
    return (unsigned)__builtin_popcount(hungry);
}
enum { LANES_AT_ONCE = 16 };
#elif defined(__AVX2__)
/* For each set of lanes that need a word, the number of the word of each lane. */
static uint32_t spread[256][8];

__attribute__((constructor)) static void fill_spread(void)
{
    for (int set = 0; set < 256; set++)
        for (int lane = 0, taken = 0; lane < 8; lane++)
            if (set >> lane & 1)
                spread[set][lane] = (uint32_t)taken++;
}

/* Steps 8 lanes. Returns the number of words read. 8 more words are readable. */
static inline unsigned decode_vector(const struct models *m, const uint16_t *model, uint8_t *symbol, uint32_t *state,
                                     const uint16_t *word)
{
    const __m256i low16 = _mm256_set1_epi32(0xFFFF);
    __m256i x = _mm256_loadu_si256((const void *)state);
    __m256i id = _mm256_cvtepu16_epi32(_mm_loadu_si128((const void *)model));
    __m256i slot = _mm256_and_si256(x, _mm256_set1_epi32(TOTAL - 1));
    __m256i key = _mm256_or_si256(_mm256_slli_epi32(id, FIRST_BITS), _mm256_srli_epi32(slot, PRECISION - FIRST_BITS));
    __m256i j = _mm256_and_si256(_mm256_i32gather_epi32((const int *)m->first, key, 1), _mm256_set1_epi32(255));
    __m256i at = _mm256_add_epi32(_mm256_i32gather_epi32((const int *)m->offset, id, 4), j);
    __m256i entry = _mm256_i32gather_epi32((const int *)m->entry, at, 4), low, frequency;
    for (;;) {
        low = _mm256_and_si256(entry, low16);
        frequency = _mm256_srli_epi32(entry, 16);
        __m256i right = _mm256_cmpgt_epi32(_mm256_add_epi32(low, frequency), slot);
        __m256i late = _mm256_xor_si256(right, _mm256_set1_epi32(-1));
        if (_mm256_testz_si256(late, late))
            break;
        j = _mm256_sub_epi32(j, late);
        at = _mm256_sub_epi32(at, late);
        entry = _mm256_mask_i32gather_epi32(entry, (const int *)m->entry, at, late, 4);
    }
    x = _mm256_add_epi32(_mm256_mullo_epi32(frequency, _mm256_srli_epi32(x, PRECISION)), _mm256_sub_epi32(slot, low));
    __m256i small = _mm256_cmpeq_epi32(_mm256_srli_epi32(x, 16), _mm256_setzero_si256());
    unsigned hungry = (unsigned)_mm256_movemask_ps((__m256)small);
    __m256i more = _mm256_cvtepu16_epi32(_mm_loadu_si128((const void *)word));
    more = _mm256_permutevar8x32_epi32(more, _mm256_loadu_si256((const void *)spread[hungry]));
    x = _mm256_blendv_epi8(x, _mm256_or_si256(_mm256_slli_epi32(x, 16), more), small);
    _mm256_storeu_si256((void *)state, x);
    __m128i halves = _mm_packus_epi32(_mm256_castsi256_si128(j), _mm256_extracti128_si256(j, 1));
    _mm_storel_epi64((void *)symbol, _mm_packus_epi16(halves, halves));
    return (unsigned)__builtin_popcount(hungry);
}
enum { LANES_AT_ONCE = 8 };
#endif

/* words: 16 more than the stream are readable. state: from encode. Returns the number of words read. */
int64_t decode(const struct models *m, const uint16_t *model, int64_t count, uint32_t *state, const uint16_t *words,
               uint8_t *symbol)
{
    const uint16_t *word = words;
    int64_t i = 0;
#if defined(__AVX2__)
    for (; i + LANES <= count; i += LANES)
        for (int lane = 0; lane < LANES; lane += LANES_AT_ONCE)
            word += decode_vector(m, model + i + lane, symbol + i + lane, state + lane, word);
#endif
    for (; i < count; i++)
        symbol[i] = decode_one(m, model[i], state + i % LANES, &word);
    return word - words;
}

/* ---------------------------------------------------------------- output */

/* Returns 0, or 1 without memory. */
int output(int64_t bytes)
{
    void *data = malloc((size_t)bytes);
    if (!data)
        return 1;
    memset(data, 1, (size_t)bytes);
    __asm__ volatile("" : : "r"(data) : "memory");
    free(data);
    return 0;
}
