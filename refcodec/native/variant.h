/* The coding of substreams and chunks, for one kind of vectors. kernel.c includes this file once for each VARIANT.
 *
 * The steps are in the order of SPEC.md. What depends on vectors is in three places: the products of a layer, the rANS
 * step, and the CRC-32. The compiler makes vectors of the plain loops.
 */

/* ----------------------------------------------------------------------------------- SPEC 7.2: products of pairs -- */

/* VECTOR: int32 numbers, LANES of them. PAIRS: as many pairs of int16 weights. */
#undef VECTOR
#undef PAIRS
#undef LANES
#undef LOAD_PAIRS
#undef LOAD
#undef STORE
#undef DOT
#undef SHIFT
#undef STORE_CLAMPED
#undef TILE_MOST
#undef TILE_ROWS
#undef ADD

#if defined(HAS_VNNI) || defined(HAS_AVX512)
#define VECTOR __m512i
#define PAIRS __m512i
#define LANES 16
#define LOAD_PAIRS(p) _mm512_loadu_si512(p)
#define LOAD(p) _mm512_loadu_si512(p)
#define STORE(p, v) _mm512_storeu_si512(p, v)
#define ADD(a, b) _mm512_add_epi32(a, b)
#if defined(HAS_VNNI)
#define DOT(acc, pair, w) NAMED(dot)(acc, _mm512_set1_epi32(pair), w)
#else
#define DOT(acc, pair, w) _mm512_add_epi32(acc, _mm512_madd_epi16(_mm512_set1_epi32(pair), w))
#endif
#define SHIFT(v, p) _mm512_srav_epi32(v, LOAD(p))
#define STORE_CLAMPED(p, v)                                                                                          \
    _mm256_storeu_si256((void *)(p), _mm512_cvtepi32_epi16(_mm512_min_epi32(                                         \
                                         _mm512_max_epi32(v, _mm512_setzero_si512()), _mm512_set1_epi32(ACTIVATION_MAX))))
#elif defined(HAS_AVX2)
#define VECTOR __m256i
#define PAIRS __m256i
#define LANES 8
#define LOAD_PAIRS(p) _mm256_loadu_si256((const void *)(p))
#define LOAD(p) _mm256_loadu_si256((const void *)(p))
#define STORE(p, v) _mm256_storeu_si256((void *)(p), v)
#define ADD(a, b) _mm256_add_epi32(a, b)
#define DOT(acc, pair, w) _mm256_add_epi32(acc, _mm256_madd_epi16(_mm256_set1_epi32(pair), w))
#define SHIFT(v, p) _mm256_srav_epi32(v, LOAD(p))
/* Saturation to int16 keeps the order, so the clamp to [0, 1023] may follow it. */
#define STORE_CLAMPED(p, v)                                                                                          \
    _mm_storeu_si128((void *)(p),                                                                                    \
                     _mm_min_epi16(_mm_max_epi16(_mm_packs_epi32(_mm256_castsi256_si128(v), _mm256_extracti128_si256(v, 1)), \
                                                 _mm_setzero_si128()),                                               \
                                   _mm_set1_epi16(ACTIVATION_MAX)))
#elif defined(HAS_NEON)
#define VECTOR int32x4_t
#define PAIRS int16x4x2_t
#define LANES 4
#define LOAD_PAIRS(p) vld2_s16(p)
#define LOAD(p) vld1q_s32(p)
#define STORE(p, v) vst1q_s32(p, v)
#define ADD(a, b) vaddq_s32(a, b)
#define DOT(acc, pair, w)                                                                                            \
    vmlal_s16(vmlal_s16(acc, (w).val[0], vdup_n_s16((int16_t)(pair))), (w).val[1], vdup_n_s16((int16_t)((pair) >> 16)))
#define SHIFT(v, p) vshlq_s32(v, vnegq_s32(LOAD(p)))
#define STORE_CLAMPED(p, v)                                                                                          \
    vst1_s16(p, vmin_s16(vmax_s16(vqmovn_s32(v), vdup_n_s16(0)), vdup_n_s16(ACTIVATION_MAX)))
#else
/* The vectors of module.h. */
#define VECTOR ints
#define PAIRS shorts
#define LANES 4
#define LOAD_PAIRS(p) (*(const shorts *)(p))
#define LOAD(p) (*(const ints *)(p))
#define STORE(p, v) (*(ints *)(p) = (v))
#define ADD(a, b) ((a) + (b))
#define DOT(acc, pair, w) ((acc) + pair_products((shorts)(ints){pair, pair, pair, pair}, w))
/* SSE2 and WebAssembly cannot shift each number by its own count. */
#define SHIFT(v, p) ((ints){(v)[0] >> (p)[0], (v)[1] >> (p)[1], (v)[2] >> (p)[2], (v)[3] >> (p)[3]})
#define STORE_CLAMPED(p, v)                                                                                          \
    do {                                                                                                             \
        ints own = (v) & ~((v) >> 31), past = own > ACTIVATION_MAX;                                                  \
        *(few_shorts *)(p) = __builtin_convertvector((own & ~past) | (past & ACTIVATION_MAX), few_shorts);           \
    } while (0)
#endif

#if defined(HAS_VNNI)
/* The instruction adds to its own register. GCC 12 copies the sums of _mm512_dpwssd_epi32 to other ones in each step. */
INLINE __m512i NAMED(dot)(__m512i acc, __m512i pair, __m512i w)
{
    __asm__("vpdpwssd %2, %1, %0" : "+v"(acc) : "v"(pair), "v"(w));
    return acc;
}
#endif

/* As many vectors of sums as there are registers for: of a tile with so many vectors of outputs, the rows. Sums of one
 * vector wait for each other, so that few vectors need many rows. SSE2 and a browser on x86-64 have 16 registers.
 */
#if LANES == 4 && !defined(HAS_NEON)
#define TILE_MOST 2
#define TILE_ROWS(vectors) (ROWS / 2)
#else
#define TILE_MOST (LANES == 16 ? 5 : LANES == 8 ? 3 : 4)
#define TILE_ROWS(vectors) ((vectors) <= (LANES == 16 ? 3 : 1) ? ROWS : ROWS / 2)
#endif

/* Computes a tile of `vectors` vectors for `rows` rows. The compiler knows both numbers.
 *
 * add: whether they are added to what `last` has.
 */
INLINE void NAMED(tile)(const layer *l, const tile *t, const int16_t *a, int32_t stride, const int rows,
                        const int vectors, int16_t *hidden, int32_t *last, int32_t to, const int add)
{
    const int32_t o = t->first;
    VECTOR acc[ROWS][5];
    UNROLL for (int r = 0; r < rows; r++)
        UNROLL for (int z = 0; z < vectors; z++) acc[r][z] = LOAD(l->bias + o + LANES * z);
    const int16_t *w = t->weight;
    const int16_t *input[ROWS];
    UNROLL for (int r = 0; r < rows; r++) input[r] = a + (int64_t)r * stride;
    for (int32_t i = 0; i < t->count; i++, w += 2 * LANES * vectors) {
        const int64_t place = 2 * t->pair[i];
        PAIRS weights[5];
        UNROLL for (int z = 0; z < vectors; z++) weights[z] = LOAD_PAIRS(w + 2 * LANES * z);
        UNROLL for (int r = 0; r < rows; r++) {
            int32_t pair = (int32_t)load32(input[r] + place);
            UNROLL for (int z = 0; z < vectors; z++) acc[r][z] = DOT(acc[r][z], pair, weights[z]);
        }
    }
    UNROLL for (int z = 0; z < vectors; z++)
        UNROLL for (int r = 0; r < rows; r++) {
            VECTOR y = SHIFT(acc[r][z], l->shift + o + LANES * z);
            if (hidden) {
                STORE_CLAMPED(hidden + (int64_t)r * to + o + LANES * z, y);
            } else {
                int32_t *own = last + (int64_t)r * to + o + LANES * z;
                if (add) y = ADD(y, LOAD(own));
                STORE(own, y);
            }
        }
}

/* The tiles of ROWS rows. */
INLINE void NAMED(tiles)(const layer *l, const tile *t, const int16_t *a, int32_t stride, const int vectors,
                         int16_t *hidden, int32_t *last, int32_t to, const int add)
{
    const int rows = TILE_ROWS(vectors);
    for (int32_t r = 0; r < ROWS; r += rows) {
        int16_t *h = hidden ? hidden + (int64_t)r * to : NULL;
        int32_t *y = last ? last + (int64_t)r * to : NULL;
        NAMED(tile)(l, t, a + (int64_t)r * stride, stride, rows, vectors, h, y, to, add);
    }
}

/* SPEC 7.2, NETWORK: one layer for some rows. ROWS rows more than a multiple may be read and written.
 *
 * a: the inputs, in rows of `stride`. The outputs go to `hidden`, clamped, or to `last`, in rows of `to`. add: whether
 * they are added to what `last` has.
 */
INLINE void NAMED(layer_rows)(const layer *l, const int16_t *a, int32_t stride, int32_t rows, int16_t *hidden,
                              int32_t *last, int32_t to, const int add)
{
    for (int32_t r = 0; r < rows; r += ROWS) {
        const int16_t *x = a + (int64_t)r * stride;
        int16_t *h = hidden ? hidden + (int64_t)r * to : NULL;
        int32_t *y = last ? last + (int64_t)r * to : NULL;
        for (const tile *t = l->tile; t < l->tile + l->tiles; t++)
            switch (t->vectors) {
            case 1: NAMED(tiles)(l, t, x, stride, 1, h, y, to, add); break;
            case 2: NAMED(tiles)(l, t, x, stride, 2, h, y, to, add); break;
            case 3: NAMED(tiles)(l, t, x, stride, 3, h, y, to, add); break;
            case 4: NAMED(tiles)(l, t, x, stride, 4, h, y, to, add); break;
            default: NAMED(tiles)(l, t, x, stride, 5, h, y, to, add); break;
            }
    }
}

static void NAMED(hidden_layer)(const layer *l, const int16_t *a, int32_t stride, int32_t rows, int16_t *to)
{
    NAMED(layer_rows)(l, a, stride, rows, to, NULL, l->out, 0);
}

static void NAMED(last_layer)(const layer *l, const int16_t *a, int32_t stride, int32_t rows, int32_t *to)
{
    NAMED(layer_rows)(l, a, stride, rows, NULL, to, l->out, 0);
}

static void NAMED(add_last_layer)(const layer *l, const int16_t *a, int32_t stride, int32_t rows, int32_t *to)
{
    NAMED(layer_rows)(l, a, stride, rows, NULL, to, l->out, 1);
}

/* Runs a network on at most BLOCK rows. between: for its hidden layers, two arrays [BLOCK, WIDTH_MAX].
 *
 * add: whether the outputs are added to what `to` has.
 */
static void NAMED(run_network)(const network *n, const int16_t *a, int32_t stride, int32_t rows, int16_t *between[2],
                               int32_t *to, int add)
{
    for (int32_t i = 0; i + 1 < n->count; i++) {
        NAMED(hidden_layer)(&n->layers[i], a, stride, rows, between[i % 2]);
        a = between[i % 2];
        stride = n->layers[i].out;
    }
    if (add)
        NAMED(add_last_layer)(&n->layers[n->count - 1], a, stride, rows, to);
    else
        NAMED(last_layer)(&n->layers[n->count - 1], a, stride, rows, to);
}

/* --------------------------------------------------------------------------------------------------- SPEC 2.4: CRC -- */

/* Adds bytes to a CRC-32. */
static uint32_t NAMED(crc)(const kernel_tables *t, uint32_t crc, const void *bytes, uint64_t n)
{
    const uint8_t *p = bytes;
    uint32_t c = ~crc;
#if defined(HAS_AVX2) || defined(HAS_AVX512) || defined(HAS_VNNI)
    /* Four remainders of 16 bytes are carried 64 bytes on by carry-less products with powers of x, then joined. */
    if (n >= 128) {
        const __m128i by64 = _mm_set_epi64x(0x01c6e41596, 0x0154442bd4);
        const __m128i by16 = _mm_set_epi64x(0x00ccaa009e, 0x01751997d0);
        __m128i x[4];
        for (int i = 0; i < 4; i++) x[i] = _mm_loadu_si128((const void *)(p + 16 * i));
        x[0] = _mm_xor_si128(x[0], _mm_cvtsi32_si128((int)c));
        for (p += 64, n -= 64; n >= 64; p += 64, n -= 64)
            for (int i = 0; i < 4; i++)
                x[i] = _mm_xor_si128(_mm_xor_si128(_mm_clmulepi64_si128(x[i], by64, 0x00),
                                                   _mm_clmulepi64_si128(x[i], by64, 0x11)),
                                     _mm_loadu_si128((const void *)(p + 16 * i)));
        for (int i = 1; i < 4; i++)
            x[0] = _mm_xor_si128(
                _mm_xor_si128(_mm_clmulepi64_si128(x[0], by16, 0x00), _mm_clmulepi64_si128(x[0], by16, 0x11)), x[i]);
        uint8_t rest[16];
        _mm_storeu_si128((void *)rest, x[0]);
        c = crc_bytes(t->crc, 0, rest, sizeof rest);
    }
#endif
    return ~crc_bytes(t->crc, c, p, n);
}

/* ------------------------------------------------------------------------------------------------- SPEC 8: entropy -- */

/* SPEC 8.5, SELECT: sets model, centre and width of `count` values from value `at` on. mean: in 1/16 of a step.
 *
 * Means and scale indices are below 2^25, since they are sums of two outputs of networks. Returns whether there are raw
 * bits.
 */
static int NAMED(select)(group *g, int64_t at, const int32_t *restrict mean, const int32_t *restrict scale,
                         int32_t count)
{
    uint16_t *restrict model = g->model + at;
    int32_t *restrict centre = g->centre + at;
    uint8_t *restrict width = g->width + at;
    int any = 0;
    for (int32_t i = 0; i < count; i++) {
        int32_t raw = clamp32(((scale[i] - SCALE_END) >> 3) + 1, 0, RAW_MAX);
        int32_t row = clamp32(scale[i] - 8 * raw, SCALE_MIN, SCALE_END - 1);
        int32_t shifted = ((mean[i] - 8 * ((1 << raw) - 1) + (1 << raw >> 1)) >> raw) + 8;
        model[i] = (uint16_t)((row - SCALE_MIN) * FRACTIONS + (shifted & 15));
        centre[i] = shifted >> 4;
        width[i] = (uint8_t)raw;
        any |= raw;
    }
    return any;
}

#if defined(HAS_AVX512) || defined(HAS_VNNI)
enum { NAMED(WIDE) = 16 };

/* SPEC 8.2 and 8.3: decodes a symbol of each of WIDE lanes that are live, from symbol s on. x: their states.
 *
 * Returns the next states. escapes: how many were noted.
 */
INLINE __m512i NAMED(decode_lanes)(decoder *d, const models *m, group *g, int64_t s, __mmask16 live, __m512i x,
                                   const int values, int64_t *escapes)
{
    const __m512i slots = _mm512_set1_epi32(TOTAL - 1), bytes = _mm512_set1_epi32(255), one = _mm512_set1_epi32(1);
    __m512i id = _mm512_slli_epi32(_mm512_cvtepu16_epi32(_mm256_maskz_loadu_epi16(live, g->model + s)), 8);
    __m512i slot = _mm512_and_si512(x, slots), top = _mm512_or_si512(id, _mm512_srli_epi32(slot, SLOT_SHIFT));
    __m512i place = _mm512_and_si512(_mm512_i32gather_epi32(top, m->first, 1), bytes);
    __m512i entry = _mm512_i32gather_epi32(_mm512_or_si512(id, place), m->entry, 4);
    __m512i low = _mm512_and_si512(entry, slots), frequency = _mm512_srli_epi32(entry, 16);
    /* Few slots mean a later symbol than their top bits name. */
    __mmask16 late = _mm512_mask_cmple_epu32_mask(live, _mm512_add_epi32(low, frequency), slot);
    while (late) {
        place = _mm512_mask_add_epi32(place, late, place, one);
        entry = _mm512_mask_i32gather_epi32(entry, late, _mm512_or_si512(id, place), m->entry, 4);
        low = _mm512_and_si512(entry, slots);
        frequency = _mm512_srli_epi32(entry, 16);
        late = _mm512_mask_cmple_epu32_mask(late, _mm512_add_epi32(low, frequency), slot);
    }
    __m512i next = _mm512_add_epi32(_mm512_mullo_epi32(frequency, _mm512_srli_epi32(x, PRECISION)),
                                    _mm512_sub_epi32(slot, low));
    __mmask16 hungry = _mm512_mask_cmplt_epu32_mask(live, next, _mm512_set1_epi32(STATE_MIN));
    const uint16_t *words = d->words + (d->at < d->count ? d->at : d->count);
    __m512i word = _mm512_maskz_expand_epi32(hungry, _mm512_cvtepu16_epi32(_mm256_loadu_si256((const void *)words)));
    d->at += (uint64_t)__builtin_popcount(hungry);
    next = _mm512_mask_or_epi32(next, hungry, _mm512_slli_epi32(next, 16), word);
    __m512i found = _mm512_sub_epi32(place, _mm512_set1_epi32(MIDDLE));
    if (values) {
        found = _mm512_add_epi32(found, _mm512_maskz_loadu_epi32(live, g->centre + s));
        uint32_t rest = _mm512_mask_test_epi32_mask(live, entry, _mm512_set1_epi32(ESCAPE));
        for (; rest; rest &= rest - 1) g->escape[(*escapes)++] = (int32_t)(s + __builtin_ctz(rest));
    }
    _mm512_mask_storeu_epi32(g->value + s, live, found);
    return _mm512_mask_mov_epi32(x, live, next);
}

/* decode_symbols for WIDE * vectors lanes. */
INLINE int64_t NAMED(decode_wide)(decoder *from, const models *m, group *g, int64_t count, const int values,
                                  const int vectors)
{
    decoder d = *from;
    __m512i x[4];
    int64_t s = 0, escapes = 0;
    for (int i = 0; i < vectors; i++) x[i] = _mm512_loadu_si512(d.state + NAMED(WIDE) * i);
    for (; s + vectors * NAMED(WIDE) <= count; s += vectors * NAMED(WIDE))
        for (int i = 0; i < vectors; i++)
            x[i] = NAMED(decode_lanes)(&d, m, g, s + NAMED(WIDE) * i, 0xffff, x[i], values, &escapes);
    for (int i = 0; i < vectors && s < count; i++, s += NAMED(WIDE)) {
        int32_t left = count - s < NAMED(WIDE) ? (int32_t)(count - s) : NAMED(WIDE);
        x[i] = NAMED(decode_lanes)(&d, m, g, s, (__mmask16)((1u << left) - 1), x[i], values, &escapes);
    }
    for (int i = 0; i < vectors; i++) _mm512_storeu_si512(from->state + NAMED(WIDE) * i, x[i]);
    from->at = d.at;
    return escapes;
}
#elif defined(HAS_AVX2)
enum { NAMED(WIDE) = 8 };

/* SPEC 8.2 and 8.3: decodes a symbol of each of WIDE lanes, from symbol s on. escapes: how many were noted. */
INLINE void NAMED(decode_lanes)(const kernel_tables *t, decoder *d, const models *m, group *g, int64_t s,
                                const int values, int64_t *escapes)
{
    const __m256i slots = _mm256_set1_epi32(TOTAL - 1), bytes = _mm256_set1_epi32(255);
    uint32_t *state = d->state + (s & (d->lanes - 1));
    const int *entries = (const int *)m->entry, *first = (const int *)(const void *)m->first;
    __m256i x = LOAD(state), id = _mm256_cvtepu16_epi32(_mm_loadu_si128((const void *)(g->model + s)));
    __m256i slot = _mm256_and_si256(x, slots);
    id = _mm256_slli_epi32(id, 8);
    __m256i top = _mm256_or_si256(id, _mm256_srli_epi32(slot, SLOT_SHIFT));
    __m256i place = _mm256_and_si256(_mm256_i32gather_epi32(first, top, 1), bytes);
    __m256i entry = _mm256_i32gather_epi32(entries, _mm256_or_si256(id, place), 4), low, frequency;
    /* Few slots mean a later symbol than their top bits name. */
    for (;;) {
        low = _mm256_and_si256(entry, slots);
        frequency = _mm256_srli_epi32(entry, 16);
        __m256i right = _mm256_cmpgt_epi32(_mm256_add_epi32(low, frequency), slot);
        if (_mm256_movemask_epi8(right) == -1) break;
        place = _mm256_add_epi32(place, _mm256_andnot_si256(right, _mm256_set1_epi32(1)));
        entry = _mm256_i32gather_epi32(entries, _mm256_or_si256(id, place), 4);
    }
    x = _mm256_add_epi32(_mm256_mullo_epi32(frequency, _mm256_srli_epi32(x, PRECISION)), _mm256_sub_epi32(slot, low));
    __m256i hungry = _mm256_cmpeq_epi32(_mm256_srli_epi32(x, 16), _mm256_setzero_si256());
    uint32_t set = (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(hungry));
    const uint16_t *words = d->words + (d->at < d->count ? d->at : d->count);
    __m256i word = _mm256_permutevar8x32_epi32(
        _mm256_cvtepu16_epi32(_mm_loadu_si128((const void *)words)),
        _mm256_cvtepu8_epi32(_mm_loadl_epi64((const void *)t->before[set])));
    d->at += (uint64_t)__builtin_popcount(set);
    STORE(state, _mm256_blendv_epi8(x, _mm256_or_si256(_mm256_slli_epi32(x, 16), word), hungry));
    __m256i found = _mm256_sub_epi32(place, _mm256_set1_epi32(MIDDLE));
    if (values) {
        found = _mm256_add_epi32(found, LOAD(g->centre + s));
        uint32_t rest = (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(_mm256_slli_epi32(entry, 16)));
        for (; rest; rest &= rest - 1) g->escape[(*escapes)++] = (int32_t)(s + __builtin_ctz(rest));
    }
    STORE(g->value + s, found);
}
#endif

/* SPEC 8.2 and 8.3: decodes a group of symbols. Lane i mod lanes codes symbol i.
 *
 * values: whether they are values. Then the value is centre + symbol - R, and escapes are noted. Returns their number.
 */
INLINE int64_t NAMED(decode_symbols)(const kernel_tables *t, decoder *d, const models *m, group *g, int64_t count,
                                     const int values)
{
    (void)t;
    const int32_t lanes = d->lanes;
    int64_t escapes = 0;
#if defined(HAS_AVX512) || defined(HAS_VNNI)
    if (lanes >= NAMED(WIDE)) {
        /* The states of so many lanes stay in registers. */
        if (lanes == 2 * NAMED(WIDE)) return NAMED(decode_wide)(d, m, g, count, values, 2);
        for (int64_t s = 0; s < count; s += NAMED(WIDE)) {
            int32_t lane = (int32_t)(s & (lanes - 1)), left = count - s < NAMED(WIDE) ? (int32_t)(count - s) : NAMED(WIDE);
            __m512i x = _mm512_loadu_si512(d->state + lane);
            x = NAMED(decode_lanes)(d, m, g, s, (__mmask16)((1u << left) - 1), x, values, &escapes);
            _mm512_storeu_si512(d->state + lane, x);
        }
        return escapes;
    }
#endif
    int64_t done = 0;
#if defined(HAS_AVX2)
    if (lanes >= NAMED(WIDE))
        for (; done + NAMED(WIDE) <= count; done += NAMED(WIDE))
            NAMED(decode_lanes)(t, d, m, g, done, values, &escapes);
#endif
    const uint16_t *model = g->model, *words = d->words;
    const uint8_t *first = m->first;
    const uint32_t *entries = m->entry;
    uint64_t at = d->at, held = d->count;
    for (; done < count; done += lanes) {
        /* A vector may have ended between the first lane and the last. */
        uint32_t *state = d->state + (done & (lanes - 1));
        int32_t live = count - done < lanes ? (int32_t)(count - done) : lanes;
        for (int32_t lane = 0; lane < live; lane++) {
            uint32_t x = state[lane], slot = x & (TOTAL - 1), id = model[done + lane];
            uint32_t place = id * PLACES + first[id * SLOT_TOP + (slot >> SLOT_SHIFT)], entry = entries[place];
            while ((entry & (TOTAL - 1)) + (entry >> 16) <= slot) entry = entries[++place];
            x = (entry >> 16) * (x >> PRECISION) + slot - (entry & (TOTAL - 1));
            state[lane] = fed(x, words[at < held ? at : held]);
            at += x < STATE_MIN;
            int32_t found = (int32_t)(place % PLACES) - MIDDLE;
            if (values) {
                if (entry & ESCAPE) g->escape[escapes++] = (int32_t)(done + lane);
                found += g->centre[done + lane];
            }
            g->value[done + lane] = found;
        }
    }
    d->at = at;
    return escapes;
}

/* SPEC 8.2: decodes a group of symbols that are no values. */
ALONE void NAMED(decode_plain)(const kernel_tables *t, decoder *d, const models *m, group *g, int64_t count)
{
    NAMED(decode_symbols)(t, d, m, g, count, 0);
    d->crc = NAMED(crc)(t, d->crc, g->value, 4 * (uint64_t)count);
}

/* SPEC 8.5 to 8.7: decodes a group of values. raw: whether any has raw bits. limit: the largest magnitude of a value.
 *
 * A value past the limit becomes 0, and decoding goes on (SPEC 8.8).
 */
ALONE void NAMED(decode_values)(const kernel_tables *t, decoder *d, const models *m, group *g, int64_t count, int raw,
                                 int32_t limit)
{
    int64_t escapes = NAMED(decode_symbols)(t, d, m, g, count, 1), first = count, past = 0;
    int32_t *value = g->value;
    if (raw) {
        /* The raw bits of all values come before the escapes. Those of an escaped value wait in its place. */
        int64_t next = 0;
        for (int64_t i = 0; i < count; i++) {
            int32_t low = 0, width = g->width[i], escaped = next < escapes && g->escape[next] == i;
            next += escaped;
            if (width) {
                low = (int32_t)(raw_window(d) & ((1u << width) - 1));
                d->raw_at += (uint64_t)width;
            }
            /* What is no escape is below 2^25 in magnitude. */
            value[i] = escaped ? low : value[i] * (1 << width) + low;
        }
    }
    for (int64_t e = 0; e < escapes; e++) {
        int32_t i = g->escape[e];
        int64_t high = (int64_t)g->centre[i] + read_escape(d, m->radius[g->model[i]]);
        int64_t found = raw ? high * (INT64_C(1) << g->width[i]) + value[i] : high;
        if (found > limit || found < -limit) {
            if (first == count) {
                first = i;
                past = found;
            }
            found = 0;
        }
        value[i] = (int32_t)found;
    }
    int32_t outside = 0;
    for (int64_t i = 0; i < count; i++) outside |= value[i] > limit || value[i] < -limit;
    for (int64_t i = 0; outside && i < count; i++)
        if (value[i] > limit || value[i] < -limit) {
            if (i < first) {
                first = i;
                past = value[i];
            }
            value[i] = 0;
        }
    if (first < count && !d->bad_range) {
        d->bad_range = 1;
        d->past = past;
        d->limit = limit;
    }
    d->crc = NAMED(crc)(t, d->crc, value, 4 * (uint64_t)count);
}

/* SPEC B.4: ends a group whose symbols were put to the encoder's. */
static void NAMED(end_group)(const kernel_tables *t, encoder *e, const group *g, int64_t count)
{
    e->count += (uint64_t)count;
    e->ends[e->groups++] = e->count;
    e->crc = NAMED(crc)(t, e->crc, g->value, 4 * (uint64_t)count);
}

/* SPEC B.4: takes a group of symbols that are no values. */
static void NAMED(encode_plain)(const kernel_tables *t, encoder *e, const models *m, const group *g, int64_t count)
{
    for (int64_t i = 0; i < count; i++)
        e->symbol[e->count + (uint64_t)i] = m->entry[g->model[i] * PLACES + MIDDLE + g->value[i]];
    NAMED(end_group)(t, e, g, count);
}

/* SPEC B.4 and 8.5 to 8.7: takes a group of values. Returns whether all are within the limit. */
static int NAMED(encode_values)(const kernel_tables *t, encoder *e, const models *m, group *g, int64_t count, int raw,
                                int32_t limit)
{
    const int32_t *value = g->value;
    uint32_t *symbol = e->symbol + e->count;
    int32_t outside = 0;
    int64_t escapes = 0;
    for (int64_t i = 0; i < count; i++) outside |= value[i] > limit || value[i] < -limit;
    if (outside) return 0;
    if (raw)
        for (int64_t i = 0; i < count; i++)
            if (g->width[i]) put_bits(e, (uint32_t)value[i] & ((1u << g->width[i]) - 1), g->width[i]);
    for (int64_t i = 0; i < count; i++) {
        int32_t radius = m->radius[g->model[i]], away = (value[i] >> g->width[i]) - g->centre[i];
        if (away < -radius || away > radius) {
            g->escape[escapes++] = (int32_t)i;
            away = radius + 1;
        }
        symbol[i] = m->entry[g->model[i] * PLACES + MIDDLE + away] & ~(uint32_t)ESCAPE;
    }
    for (int64_t k = 0; k < escapes; k++) {
        int32_t i = g->escape[k];
        put_escape(e, (value[i] >> g->width[i]) - g->centre[i], m->radius[g->model[i]]);
    }
    NAMED(end_group)(t, e, g, count);
    return 1;
}

#if defined(HAS_AVX512) || defined(HAS_VNNI)
/* SPEC B.4: one step of 16 lanes, of those in the mask. Returns where the words begin now, which go before `next`. */
INLINE uint16_t *NAMED(encode_lanes)(uint32_t *state, const uint32_t *symbol, __mmask16 mask, uint16_t *next)
{
    __m512i x = _mm512_maskz_loadu_epi32(mask, state), entry = _mm512_maskz_loadu_epi32(mask, symbol);
    __m512i low = _mm512_and_si512(entry, _mm512_set1_epi32(0xffff)), frequency = _mm512_srli_epi32(entry, 16);
    __mmask16 full = _mm512_mask_cmpge_epu32_mask(mask, _mm512_srli_epi32(x, 32 - PRECISION), frequency);
    /* The low halves of the lanes that are full, in their order. */
    int count = __builtin_popcount(full);
    __m256i words = _mm512_cvtepi32_epi16(_mm512_maskz_compress_epi32(full, x));
    next -= count;
    _mm256_mask_storeu_epi16(next, (__mmask16)((1u << count) - 1), words);
    x = _mm512_mask_srli_epi32(x, full, x, 16);
    /* A double holds both numbers and their quotient is below 2^32, so it is cut to the right integer. */
    __m256i halves[2];
    for (int half = 0; half < 2; half++) {
        __m256i upper = half ? _mm512_extracti64x4_epi64(x, 1) : _mm512_castsi512_si256(x);
        __m256i under = half ? _mm512_extracti64x4_epi64(frequency, 1) : _mm512_castsi512_si256(frequency);
        halves[half] = _mm512_cvttpd_epu32(_mm512_div_pd(
            _mm512_cvtepu32_pd(upper), _mm512_cvtepu32_pd(_mm256_max_epu32(under, _mm256_set1_epi32(1)))));
    }
    __m512i quotient = _mm512_inserti64x4(_mm512_castsi256_si512(halves[0]), halves[1], 1);
    __m512i rest = _mm512_sub_epi32(x, _mm512_mullo_epi32(quotient, frequency));
    x = _mm512_add_epi32(_mm512_add_epi32(_mm512_slli_epi32(quotient, PRECISION), rest), low);
    _mm512_mask_storeu_epi32(state, mask, x);
    return next;
}
#endif

/* SPEC B.4 and 5.15: makes the substream of an encoder. rANS runs backwards, from the final states to the first ones.
 *
 * words: room for a word of each symbol. Returns KERNEL_DONE or KERNEL_NO_MEMORY.
 */
static int32_t NAMED(finish_encoder)(encoder *e, int32_t lanes, uint16_t *words, uint8_t **part, uint64_t *length)
{
    uint32_t state[LANES_MAX];
    uint16_t *last = words + e->count, *next = last;
    for (int32_t lane = 0; lane < lanes; lane++) state[lane] = STATE_MIN;
    for (int32_t group = e->groups - 1; group >= 0; group--) {
        uint64_t first = group ? e->ends[group - 1] : 0, count = e->ends[group] - first;
        for (uint64_t step = (count + (uint64_t)lanes - 1) / (uint64_t)lanes; step-- > 0;) {
            const uint32_t *symbol = e->symbol + first + step * (uint64_t)lanes;
            uint64_t left = count - step * (uint64_t)lanes;
            int32_t live = left < (uint64_t)lanes ? (int32_t)left : lanes;
            /* SPEC 8.3: lanes of one step take words in their order, so they give them in the reverse order. */
#if defined(HAS_AVX512) || defined(HAS_VNNI)
            if (lanes >= 8) {
                const int32_t wide = lanes < 16 ? lanes : 16;
                for (int32_t lane = (live - 1) / wide * wide; lane >= 0; lane -= wide) {
                    int32_t own = live - lane < wide ? live - lane : wide;
                    __mmask16 mask = (__mmask16)((1u << own) - 1);
                    next = NAMED(encode_lanes)(state + lane, symbol + lane, mask, next);
                }
                continue;
            }
#endif
            for (int32_t lane = live; lane-- > 0;) {
                uint32_t x = state[lane], low = symbol[lane] & 0xffff, frequency = symbol[lane] >> 16;
                uint32_t full = x >> (32 - PRECISION) >= frequency;
                next[-1] = (uint16_t)x;
                next -= full;
                x = full ? x >> 16 : x;
                uint32_t quotient = x / frequency;
                state[lane] = (quotient << PRECISION) + (x - quotient * frequency) + low;
            }
        }
    }
    uint64_t sent = (uint64_t)(last - next), head = SUBSTREAM_HEAD + 4 * (uint64_t)lanes;
    if (e->bit_count) put_bits(e, 0, 8 - e->bit_count);
    *length = head + 2 * sent + e->raw.length;
    *part = e->raw.failed || *length > SIZE_MAX ? NULL : malloc((size_t)*length);
    if (!*part) return KERNEL_NO_MEMORY;
    store32(*part, e->crc);
    store32(*part + 4, (uint32_t)sent);
    memcpy(*part + SUBSTREAM_HEAD, state, 4 * (size_t)lanes);
    memcpy(*part + head, next, 2 * (size_t)sent);
    if (e->raw.length) memcpy(*part + head + 2 * sent, e->raw.bytes, (size_t)e->raw.length);
    return KERNEL_DONE;
}

/* Lays out an encoder of at most so many symbols, in so many groups, and room for its words. */
static void NAMED(take_encoder)(arena *a, encoder *e, uint16_t **words, uint64_t symbols, uint64_t groups)
{
    memset(e, 0, sizeof *e);
    e->symbol = take(a, symbols, 4);
    e->ends = take(a, groups, 8);
    /* A word is written before it is known whether it counts. */
    *words = take(a, symbols + 1, 2);
    if (a->base) ++*words;
}

/* -------------------------------------------------------------------------------------- SPEC 7.13: packed weights -- */

/* SPEC 7.13, DECODE_WEIGHTS: decodes the two groups, whose means are 0. counts: of both. Returns DONE or NO_MEMORY. */
static int32_t NAMED(decode_weights)(const kernel_tables *t, decoder *d, const uint8_t *scale, const uint64_t counts[2],
                                     int32_t *to)
{
    workspace w = {NULL, NULL, 0};
    for (int k = 0; k < 2; scale += counts[k], to += counts[k], k++) {
        const uint64_t count = counts[k];
        int32_t *mean = NULL, *index = NULL;
        group g;
        for (int pass = 0; pass < 2; pass++) {
            arena a = {pass ? w.base : NULL, 0};
            take_group(&a, &g, count);
            mean = take(&a, count, 4);
            index = take(&a, count, 4);
            if (!pass && !reserve(&w, a.used)) return KERNEL_NO_MEMORY;
        }
        for (uint64_t i = 0; i < count; i++) {
            mean[i] = 0;
            index[i] = SCALE_MIN + scale[i];
        }
        int raw = NAMED(select)(&g, 0, mean, index, (int32_t)count);
        NAMED(decode_values)(t, d, k ? &t->gauss : &t->laplace, &g, (int64_t)count, raw, WEIGHT_SYMBOL_MAX);
        memcpy(to, g.value, 4 * (size_t)count);
    }
    free(w.block);
    return KERNEL_DONE;
}

/* ---------------------------------------------------------------------------------------------- SPEC 7.3: planes -- */

/* What the coding of a sub-plane works with. at: of each point of a wavefront, its place among the symbols. */
typedef struct {
    int16_t *symbols, *near, *between[2];
    int32_t *y, *mean, *scale, *at;
    group g;
    encoder e;
    uint16_t *words;
} NAMED(plane_work);

static void NAMED(lay_out_plane)(arena *a, const kernel_scene *s, uint64_t words, int encode, NAMED(plane_work) *p)
{
    uint64_t size = (uint64_t)s->plane_size, channels = (uint64_t)s->channels, points = channels * (size / 2 + 2);
    p->symbols = take(a, channels * (size + 1) * (size + 2), 2);
    p->near = take(a, 4 * (points + BLOCK), 2);
    for (int i = 0; i < 2; i++) p->between[i] = take(a, (BLOCK + ROWS) * WIDTH_MAX, 2);
    p->y = take(a, (BLOCK + ROWS) * OUTPUTS, 4);
    p->mean = take(a, points + BLOCK, 4);
    p->scale = take(a, points + BLOCK, 4);
    p->at = take(a, points, 4);
    take_group(a, &p->g, points);
    p->words = take(a, encode ? 0 : words + WORDS_PAST, 2);
    if (encode) NAMED(take_encoder)(a, &p->e, &p->words, channels * size * size, 3 * size);
}

/* Codes a sub-plane [channels, size, size] with one of the two. Returns whether all symbols are within the limit. */
static int NAMED(code_plane)(const kernel_scene *s, NAMED(plane_work) *p, decoder *d, encoder *e, const int16_t *given)
{
    const int32_t size = s->plane_size, row = size + 2, block = (size + 1) * row;
    const models *m = &s->tables->laplace;
    /* The border of zeros above, left and right stands for the symbols outside the sub-plane. */
    memset(p->symbols, 0, 2 * (size_t)s->channels * (size_t)block);
    for (int32_t t = 0; t < 3 * size - 2; t++) {
        /* SPEC 7.3: wavefront t has the points with j + 2 i = t. */
        int32_t first = t - size + 2 > 0 ? (t - size + 2) / 2 : 0, last = t / 2 < size - 1 ? t / 2 : size - 1;
        int32_t count = 0;
        for (int32_t c = 0; c < s->channels; c++)
            for (int32_t i = first; i <= last; i++, count++) {
                int32_t j = t - 2 * i, at = c * block + (i + 1) * row + j + 1;
                /* The context of (i, j) is (i-1, j-1), (i-1, j), (i-1, j+1) and (i, j-1). */
                const int32_t near[4] = {at - row - 1, at - row, at - row + 1, at - 1};
                for (int k = 0; k < 4; k++)
                    p->near[4 * count + k] =
                        (int16_t)clamp32(p->symbols[near[k]], -ACTIVATION_MAX, ACTIVATION_MAX);
                p->at[count] = at;
                if (given) p->g.value[count] = given[((int64_t)c * size + i) * size + j];
            }
        for (int32_t b = 0; b < count; b += BLOCK) {
            int32_t rows = count - b < BLOCK ? count - b : BLOCK;
            NAMED(run_network)(&s->sarm, p->near + 4 * b, 4, rows, p->between, p->y, 0);
            for (int32_t r = 0; r < rows; r++) {
                p->mean[b + r] = p->y[OUTPUTS * r];
                p->scale[b + r] = p->y[OUTPUTS * r + 1];
            }
        }
        int raw = NAMED(select)(&p->g, 0, p->mean, p->scale, count);
        if (d)
            NAMED(decode_values)(s->tables, d, m, &p->g, count, raw, PLANE_SYMBOL_MAX);
        else if (!NAMED(encode_values)(s->tables, e, m, &p->g, count, raw, PLANE_SYMBOL_MAX))
            return 0;
        for (int32_t i = 0; i < count; i++) p->symbols[p->at[i]] = (int16_t)p->g.value[i];
    }
    return 1;
}

static int32_t NAMED(decode_plane)(const kernel_scene *s, const uint8_t *part, uint64_t length, int16_t *plane,
                                   workspace *w, kernel_verdict *v)
{
    NAMED(plane_work) p;
    decoder d;
    arena a = {NULL, 0};
    NAMED(lay_out_plane)(&a, s, length / 2, 0, &p);
    if (!reserve(w, a.used)) return KERNEL_NO_MEMORY;
    a = (arena){w->base, 0};
    NAMED(lay_out_plane)(&a, s, length / 2, 0, &p);
    int32_t error = open_decoder(&d, part, length, s->plane_lanes, p.words);
    if (error) return error;
    NAMED(code_plane)(s, &p, &d, NULL, NULL);
    int32_t size = s->plane_size;
    for (int32_t c = 0; c < s->channels; c++)
        for (int32_t i = 0; i < size; i++)
            memcpy(plane + ((int64_t)c * size + i) * size,
                   p.symbols + ((int64_t)c * (size + 1) + i + 1) * (size + 2) + 1, 2 * (size_t)size);
    return close_decoder(&d, v);
}

static int32_t NAMED(encode_plane)(const kernel_scene *s, const int16_t *plane, uint8_t **part, uint64_t *length,
                                   workspace *w)
{
    NAMED(plane_work) p;
    arena a = {NULL, 0};
    NAMED(lay_out_plane)(&a, s, 0, 1, &p);
    if (!reserve(w, a.used)) return KERNEL_NO_MEMORY;
    a = (arena){w->base, 0};
    NAMED(lay_out_plane)(&a, s, 0, 1, &p);
    int32_t status = KERNEL_REFUSED;
    if (NAMED(code_plane)(s, &p, NULL, &p.e, plane))
        status = NAMED(finish_encoder)(&p.e, s->plane_lanes, p.words, part, length);
    free(p.e.raw.bytes);
    return status;
}

/* -------------------------------------------------------------------------------------------- SPEC 7.5: contexts -- */

/* SPEC 7.5.1 to 7.5.3: rescaled coordinates of BLOCK anchors. bits: their fp16 bits, an array for each axis.
 *
 * All loops have BLOCK rounds without a branch, so that the compiler makes vectors of them.
 */
static void NAMED(rescale)(const kernel_scene *s, uint16_t bits[3][BLOCK], int32_t u[3][BLOCK])
{
    int64_t p[3][BLOCK];
    double v[3][BLOCK], length[BLOCK], factor[BLOCK];
    for (int axis = 0; axis < 3; axis++)
        for (int r = 0; r < BLOCK; r++) p[axis][r] = position_integer(bits[axis][r]);
    /* SPEC 7.5.1: |P| < 2^40, |A| < 2^20 and |T| < 2^61, so that |sum| < 2^62. With 2^63 added it is an unsigned number,
     * which every kind of vectors can shift.
     */
    for (int axis = 0; axis < 3; axis++) {
        const int64_t *row = s->matrix + 3 * axis, shift = s->shift[axis];
        const uint64_t middle = UINT64_C(1) << 63;
        const uint64_t more = middle + (uint64_t)s->translation[axis] + (UINT64_C(1) << shift >> 1);
        for (int r = 0; r < BLOCK; r++) {
            uint64_t sum = (uint64_t)(row[0] * p[0][r] + row[1] * p[1][r] + row[2] * p[2][r]) + more;
            int64_t found = (int64_t)((sum >> shift) - (middle >> shift));
            v[axis][r] = (double)(int32_t)clamp64(found, -FRAME_CLAMP, FRAME_CLAMP);
        }
    }
    /* From here on, numbers of doubles are integers below 2^53. FLOOR(a / b) of such a and b > 0 is the floor of their
     * quotient as a double: that is a / b with an error of at most |a / b| 2^-53 < 1 / b, and a quotient that is no
     * integer is at least 1 / b away from every integer. So rounding does not reach the next one.
     *
     * SPEC 7.5.2: n = ISQRT(q), with q < 2^62. The square root of doubles is less than 1 away, so n is one more or less.
     * With n = U where q <= U^2, the factor is U and the quotient v, as the clause has it. Otherwise U <= n < 2^31,
     * factor < 2 U = 2^17 and |v factor| < 2^47.
     */
    for (int r = 0; r < BLOCK; r++) {
        double x = v[0][r], y = v[1][r], z = v[2][r];
        int32_t i = (int32_t)x, j = (int32_t)y, k = (int32_t)z, n = (int32_t)__builtin_sqrt(x * x + y * y + z * z);
        int64_t rest = (int64_t)i * i + (int64_t)j * j + (int64_t)k * k - (int64_t)n * n;
        double exact = (double)n - (rest < 0) + (rest > 2 * (int64_t)n);
        length[r] = exact < UNIT ? UNIT : exact;
    }
    for (int r = 0; r < BLOCK; r++) factor[r] = floor32((2 * length[r] - UNIT) * UNIT / length[r]);
    /* SPEC 7.5.3: |w| <= 2^17 and |low| <= 2^18, so that the dividend is below 2^35. Both bounds are integers, so that
     * the clamp may come before the floor.
     */
    for (int axis = 0; axis < 3; axis++) {
        const double low = s->low[axis], range = (double)s->high[axis] - low;
        for (int r = 0; r < BLOCK; r++) {
            double w = floor32(v[axis][r] * factor[r] / length[r]), quotient = (w - low) * UNIT / range;
            quotient = quotient < 0 ? 0 : quotient;
            u[axis][r] = (int32_t)(quotient > UNIT ? UNIT : quotient);
        }
    }
}

/* SPEC 7.5.4: the samples of some channels. corners: the weights of upper and of lower points. */
INLINE void NAMED(sample)(const int16_t *restrict upper, const int16_t *restrict lower, int32_t channels, int32_t count,
                          const int32_t corners[4], int32_t shift, int16_t *restrict to)
{
    /* The weights sum to 2^16 and symbols are below 2^15, so the sums fit. */
    for (int32_t c = 0; c < count; c++) {
        int32_t sum = upper[c] * corners[0] + upper[c + channels] * corners[1] + lower[c] * corners[2] +
                      lower[c + channels] * corners[3];
        to[c] = (int16_t)clamp32((sum + (1 << shift >> 1)) >> shift, -ACTIVATION_MAX, ACTIVATION_MAX);
    }
}

/* SPEC 7.5: the contexts of at most BLOCK anchors, from their fp16 bits [rows, 3]. to: [rows, stride]. */
static void NAMED(contexts)(const kernel_scene *s, const uint16_t *bits, int32_t rows, int32_t stride, int16_t *to)
{
    enum { TOGETHER = 8 };
    const int32_t channels = s->channels, shift = 16 - s->plane_shift;
    uint16_t own[3][BLOCK];
    int32_t u[3][BLOCK], at[BLOCK], f[2][BLOCK];
    memset(own, 0, sizeof own);
    for (int32_t r = 0; r < rows; r++)
        for (int axis = 0; axis < 3; axis++) own[axis][r] = bits[3 * r + axis];
    NAMED(rescale)(s, own, u);
    /* SPEC 7.5.4: bilinear samples of both planes. */
    for (int plane = 0; plane < 2 && channels; plane++) {
        const int32_t size = s->plane_size << plane, line = size * channels;
        for (int r = 0; r < BLOCK; r++) {
            int32_t place = 0;
            for (int axis = 1; axis >= 0; axis--) {
                int32_t grid = u[axis][r] * (size - 1), cell = grid >> 16 < size - 2 ? grid >> 16 : size - 2;
                f[axis][r] = (grid - (cell << 16) + 128) >> 8;
                place = place * size + cell;
            }
            at[r] = place * channels;
        }
        for (int32_t r = 0; r < rows; r++) {
            __builtin_prefetch(s->joined[plane] + at[r]);
            __builtin_prefetch(s->joined[plane] + at[r] + line);
        }
        for (int32_t r = 0; r < rows; r++) {
            const int16_t *upper = s->joined[plane] + at[r], *lower = upper + line;
            int16_t *samples = to + (int64_t)r * stride + plane * channels;
            const int32_t x = f[0][r], y = f[1][r];
            const int32_t corners[4] = {(256 - x) * (256 - y), x * (256 - y), (256 - x) * y, x * y};
            int32_t c = 0;
            for (; c + TOGETHER <= channels; c += TOGETHER)
                NAMED(sample)(upper + c, lower + c, channels, TOGETHER, corners, shift, samples + c);
            NAMED(sample)(upper + c, lower + c, channels, channels - c, corners, shift, samples + c);
        }
    }
    /* SPEC 7.5.5: the sine and the cosine of each frequency. */
    for (int32_t r = 0; r < rows; r++) {
        const uint32_t angle = (uint32_t)u[2][r] - UNIT / 2;
        int16_t *pair = to + (int64_t)r * stride + 2 * channels;
        for (int32_t k = 0; k < s->frequencies; k++, pair += 2)
            store32(pair, s->tables->turn[((angle << k & (UNIT - 1)) + 32) / (UNIT / SINE_LENGTH) % SINE_LENGTH]);
    }
}

/* ------------------------------------------------------------------------------------------------ chunks: memory -- */

/* What the coding of a chunk works with.
 *
 * context: the inputs of F_h, [BLOCK, inputs]. deep: the inputs of its output layer, [n, deep_stride].
 * seen: of the features that are known, the inputs of CARM, [n, seen_stride].
 * y: the outputs of F_h and CARM together, of a block. mean, scale: of the values of a block.
 * codes, nodes: of a tree of cells. low, known: of each node, the symbol of its lower half, and all its children.
 * kept: of each anchor, how many offsets it keeps so far. steps: [n, 3], for a comparison.
 */
typedef struct {
    int16_t *context, *deep, *seen, *between[2];
    int32_t context_stride, deep_stride, seen_stride;
    int32_t *y, *mean, *scale;
    uint64_t *codes, *nodes;
    uint8_t *low, *known, *kept, *steps;
    group g;
    encoder e;
    uint16_t *words;
} NAMED(chunk_work);

/* What is laid out. */
enum NAMED(purpose) { NAMED(FOR_CELLS), NAMED(FOR_MASKS), NAMED(FOR_ATTRIBUTES) };

static void NAMED(lay_out_chunk)(arena *a, const kernel_scene *s, uint64_t n, int purpose, uint64_t words, int encode,
                                 NAMED(chunk_work) *c)
{
    uint64_t symbols = n, groups = 2 + KERNEL_SLICES_MAX, widest = 0;
    memset(c, 0, sizeof *c);
    if (purpose == NAMED(FOR_CELLS)) {
        c->codes = take(a, n + 1, 8);
        c->nodes = take(a, n + 1, 8);
        c->low = take(a, n, 1);
        c->known = take(a, n, 1);
        symbols = n * 2 * CELL_LEVELS;
        groups = 2 * CELL_LEVELS;
        widest = 1;
    } else if (purpose == NAMED(FOR_MASKS)) {
        c->kept = take(a, n, 1);
        symbols = n * (uint64_t)s->offset_count;
        groups = (uint64_t)s->offset_count;
        widest = 1;
    } else {
        uint64_t rows = (uint64_t)round_up((int64_t)n, ROWS) + ROWS;
        int32_t deep = s->hidden.count ? s->hidden.layers[s->hidden.count - 1].out : s->inputs;
        for (int32_t i = 0; i < s->stage_count; i++)
            if ((uint64_t)s->stages[i].width > widest) widest = (uint64_t)s->stages[i].width;
        c->context_stride = (int32_t)round_up(s->inputs, 2);
        c->deep_stride = (int32_t)round_up(deep, 2);
        c->seen_stride = (int32_t)round_up(s->features, 2);
        c->context = take(a, (BLOCK + ROWS) * (uint64_t)c->context_stride, 2);
        c->deep = take(a, rows * (uint64_t)c->deep_stride, 2);
        c->seen = take(a, rows * (uint64_t)c->seen_stride, 2);
        for (int i = 0; i < 2; i++) c->between[i] = take(a, (BLOCK + ROWS) * WIDTH_MAX, 2);
        c->y = take(a, (BLOCK + ROWS) * 2 * WIDTH_MAX, 4);
        c->mean = take(a, BLOCK * WIDTH_MAX, 4);
        c->scale = take(a, BLOCK * WIDTH_MAX, 4);
        c->steps = take(a, KINDS * n, 1);
        symbols = n * (uint64_t)s->width;
    }
    take_group(a, &c->g, n * widest);
    if (encode)
        NAMED(take_encoder)(a, &c->e, &c->words, symbols, groups);
    else
        c->words = take(a, words + WORDS_PAST, 2);
}

/* Lays a part's work out in the workspace. Returns whether there is memory. */
static int NAMED(make_room)(const kernel_scene *s, uint64_t n, int purpose, uint64_t words, int encode, workspace *w,
                            NAMED(chunk_work) *c)
{
    arena a = {NULL, 0};
    NAMED(lay_out_chunk)(&a, s, n, purpose, words, encode, c);
    if (!reserve(w, a.used)) return 0;
    a = (arena){w->base, 0};
    NAMED(lay_out_chunk)(&a, s, n, purpose, words, encode, c);
    return 1;
}

/* ------------------------------------------------------------------------------------------ SPEC 7.12: positions -- */

/* SPEC 7.12, DECODE_CELLS: codes the tree of a chunk with one of the two. codes: [n], the cells in ascending order.
 *
 * Returns how many cells there are, at most n of them, and n + 1 if some level had more nodes than anchors.
 */
static int64_t NAMED(code_cells)(const kernel_scene *s, NAMED(chunk_work) *c, decoder *d, encoder *e, int64_t n)
{
    static const uint8_t children[HALVES] = {0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4};
    uint64_t *nodes = c->nodes;
    uint8_t *known = c->known, *low = c->low;
    int64_t count = 1;
    int past = 0;
    nodes[0] = 0;
    for (int32_t level = CELL_LEVELS - 1; level >= 0; level--) {
        uint16_t first = (uint16_t)(6 * (level < 2 ? level : 2));
        if (e) {
            /* The children of each node, a bit for each. */
            int64_t node = -1;
            for (int64_t i = 0; i < n; i++) {
                uint64_t parent = c->codes[i] >> (3 * (level + 1)), bit = c->codes[i] >> (3 * level) & 7;
                if (node < 0 || parent != nodes[node]) {
                    nodes[++node] = parent;
                    known[node] = 0;
                }
                known[node] = (uint8_t)(known[node] | 1u << bit);
            }
            count = node + 1;
        }
        for (int64_t i = 0; i < count; i++) {
            c->g.model[i] = first;
            if (e) c->g.value[i] = known[i] & 15;
        }
        if (d)
            NAMED(decode_plain)(s->tables, d, &s->cells, &c->g, count);
        else
            NAMED(encode_plain)(s->tables, e, &s->cells, &c->g, count);
        for (int64_t i = 0; i < count; i++) {
            low[i] = (uint8_t)c->g.value[i];
            c->g.model[i] = (uint16_t)(first + 1 + children[low[i]]);
            if (e) c->g.value[i] = known[i] >> 4;
        }
        if (e) {
            NAMED(encode_plain)(s->tables, e, &s->cells, &c->g, count);
            continue;
        }
        NAMED(decode_plain)(s->tables, d, &s->cells, &c->g, count);
        /* SPEC 7.12: nodes past the number of the chunk's anchors are dropped, so that the time is bounded. */
        int64_t held = 0;
        for (int64_t i = 0; i < count; i++)
            for (uint32_t rest = low[i] | (uint32_t)c->g.value[i] << 4; rest; rest &= rest - 1) {
                if (held < n) c->codes[held] = nodes[i] << 3 | (uint64_t)__builtin_ctz(rest);
                held++;
            }
        past |= held > n;
        count = held < n ? held : n;
        memcpy(nodes, c->codes, 8 * (size_t)count);
    }
    return count + past;
}

/* SPEC 6.11 and 7.12: the positions of a chunk. Returns an error code or 0. */
static int32_t NAMED(decode_positions)(const kernel_scene *s, kernel_chunk *chunk, workspace *w)
{
    int64_t n = chunk->anchors;
    uint16_t *bits = chunk->positions;
    kernel_verdict *v = &chunk->verdict;
    v->part = 0;
    if (chunk->form == 0) {
        if (chunk->length[0] != RAW_POSITION * (uint64_t)n) return KERNEL_REFUSED;
        memcpy(bits, chunk->part[0], RAW_POSITION * (size_t)n);
        /* SPEC [R6.11-6] and [R6.11-7] */
        int bad = 0;
        for (int64_t i = 0; i < 3 * n; i++) bad |= (bits[i] & 0x7C00) == 0x7C00 || bits[i] == 0x8000;
        for (int64_t i = 0; bad && i < 3 * n; i++) {
            if ((bits[i] & 0x7C00) == 0x7C00) return NOT_FINITE;
            if (bits[i] == 0x8000) return NEGATIVE_ZERO;
        }
    } else {
        NAMED(chunk_work) c;
        decoder d;
        if (s->cell_shift < 0) return KERNEL_REFUSED;
        if (!NAMED(make_room)(s, (uint64_t)n, NAMED(FOR_CELLS), chunk->length[0] / 2, 0, w, &c))
            return KERNEL_NO_MEMORY;
        int32_t error = open_decoder(&d, chunk->part[0], chunk->length[0], s->mask_lanes, c.words);
        if (error) return error;
        int64_t count = NAMED(code_cells)(s, &c, &d, NULL, n);
        error = close_decoder(&d, v);
        if (error) return error;
        /* SPEC [R6.11-8] */
        if (count != n) return fault(v, CELL_COUNT, count, 0);
        /* SPEC [R6.11-9] */
        for (int64_t i = 0; i < n; i++)
            for (int axis = 0; axis < 3; axis++) {
                int32_t number = cell_number(every_third(c.codes[i] >> axis), s->cell_shift);
                if (number < 0) return fault(v, CELL_NUMBER, i, 0);
                bits[3 * i + axis] = (uint16_t)number;
            }
    }
    /* SPEC [R6.11-10] */
    for (int axis = 0; axis < 3; axis++) {
        int32_t low = fp16_order(bits[axis]), high = low;
        for (int64_t i = 1; i < n; i++) {
            int32_t order = fp16_order(bits[3 * i + axis]);
            low = order < low ? order : low;
            high = order > high ? order : high;
        }
        if (low != fp16_order(chunk->low[axis]) || high != fp16_order(chunk->high[axis])) return CHUNK_BOUNDS;
    }
    return 0;
}

/* SPEC 7.12: the positions of a chunk as a part of it. form: -1 packs them if that is possible. */
static int32_t NAMED(encode_positions)(const kernel_scene *s, kernel_chunk *chunk, workspace *w)
{
    int64_t n = chunk->anchors;
    if (chunk->form != 0 && s->cell_shift >= 0) {
        NAMED(chunk_work) c;
        int packed = 1;
        if (!NAMED(make_room)(s, (uint64_t)n, NAMED(FOR_CELLS), 0, 1, w, &c)) return KERNEL_NO_MEMORY;
        for (int64_t i = 0; i < n && packed; i++) {
            c.codes[i] = 0;
            for (int axis = 0; axis < 3; axis++) {
                int32_t cell = cell_of(chunk->positions[3 * i + axis], s->cell_shift);
                packed &= cell >= 0;
                c.codes[i] |= to_thirds((uint64_t)(cell & 0xffff)) << axis;
            }
            /* SPEC 6.11: the cells of a packed chunk ascend. */
            packed &= i == 0 || c.codes[i] > c.codes[i - 1];
        }
        if (packed) {
            NAMED(code_cells)(s, &c, NULL, &c.e, n);
            int32_t status =
                NAMED(finish_encoder)(&c.e, s->mask_lanes, c.words, &chunk->part[0], &chunk->length[0]);
            free(c.e.raw.bytes);
            chunk->form = 1;
            return status;
        }
    }
    if (chunk->form > 0) return KERNEL_REFUSED_FORM;
    chunk->form = 0;
    chunk->length[0] = RAW_POSITION * (uint64_t)n;
    chunk->part[0] = malloc((size_t)chunk->length[0] + 1);
    if (!chunk->part[0]) return KERNEL_NO_MEMORY;
    memcpy(chunk->part[0], chunk->positions, (size_t)chunk->length[0]);
    return KERNEL_DONE;
}

/* ----------------------------------------------------------------------------------------------- SPEC 7.6: masks -- */

/* SPEC 8.2: decodes symbols of two, 0 and 1. frequency: that of 1, of each context. context: that of each symbol.
 *
 * No table is read, since few lanes wait for each other's numbers.
 */
ALONE void NAMED(decode_bits)(decoder *d, const uint16_t *frequency, const uint8_t *context, int32_t *value,
                               int64_t count)
{
    const int32_t lanes = d->lanes;
    const uint16_t *words = d->words;
    uint64_t at = d->at, held = d->count;
    uint32_t state[LANES_MAX];
    memcpy(state, d->state, 4 * (size_t)lanes);
    for (int64_t i = 0; i < count; i += lanes) {
        int32_t live = count - i < lanes ? (int32_t)(count - i) : lanes;
        for (int32_t lane = 0; lane < live; lane++) {
            uint32_t x = state[lane], slot = x & (TOTAL - 1), high = frequency[context[i + lane]], low = TOTAL - high;
            uint32_t bit = slot >= low, size = bit ? high : low, start = bit ? low : 0;
            x = size * (x >> PRECISION) + slot - start;
            state[lane] = fed(x, words[at < held ? at : held]);
            at += x < STATE_MIN;
            value[i + lane] = (int32_t)bit;
        }
    }
    memcpy(d->state, state, 4 * (size_t)lanes);
    d->at = at;
}

/* Codes the masks of a chunk with one of the two. Returns how many offsets are kept. */
static uint64_t NAMED(code_masks)(const kernel_scene *s, NAMED(chunk_work) *c, decoder *d, encoder *e, uint8_t *masks,
                                  int64_t n)
{
    const int32_t offsets = s->offset_count;
    int32_t *value = c->g.value;
    uint64_t total = 0;
    memset(c->kept, 0, (size_t)n);
    for (int32_t k = 0; k < offsets; k++) {
        /* SPEC 7.6: the context is the index of the offset, and how many the anchor keeps before it. */
        const uint16_t *frequency = s->kept + k * (k + 1) / 2;
        if (d) {
            NAMED(decode_bits)(d, frequency, c->kept, value, n);
            d->crc = NAMED(crc)(s->tables, d->crc, value, 4 * (uint64_t)n);
        } else {
            for (int64_t i = 0; i < n; i++) {
                uint32_t high = frequency[c->kept[i]], low = TOTAL - high;
                value[i] = masks[i * offsets + k] != 0;
                e->symbol[e->count + (uint64_t)i] = value[i] ? low | high << 16 : low << 16;
            }
            NAMED(end_group)(s->tables, e, &c->g, n);
        }
        for (int64_t i = 0; i < n; i++) {
            c->kept[i] = (uint8_t)(c->kept[i] + value[i]);
            if (d) masks[i * offsets + k] = (uint8_t)value[i];
        }
    }
    for (int64_t i = 0; i < n; i++) total += c->kept[i];
    return total;
}

/* ---------------------------------------------------------------------------------- SPEC 7.7 to 7.10: attributes -- */

/* SPEC 7.5 and 7.7: the hidden layers of F_h, for all anchors of a chunk. */
static void NAMED(deepen)(const kernel_scene *s, NAMED(chunk_work) *c, const uint16_t *positions, int64_t n)
{
    const int32_t hidden = s->hidden.count;
    for (int64_t b = 0; b < n; b += BLOCK) {
        int32_t rows = n - b < BLOCK ? (int32_t)(n - b) : BLOCK;
        int16_t *deep = c->deep + b * c->deep_stride, *to = hidden ? c->context : deep;
        if (s->has_frame)
            NAMED(contexts)(s, positions + 3 * b, rows, c->context_stride, to);
        const int16_t *from = to;
        int32_t stride = c->context_stride;
        for (int32_t i = 0; i < hidden; i++) {
            to = i + 1 < hidden ? c->between[i] : deep;
            NAMED(hidden_layer)(&s->hidden.layers[i], from, stride, rows, to);
            from = to;
            stride = s->hidden.layers[i].out;
        }
    }
}

/* SPEC 7.8: step indices, from three outputs of F_h. */
INLINE void NAMED(steps_of)(const int32_t *y, uint8_t *steps)
{
    for (int kind = 0; kind < KINDS; kind++) steps[kind] = (uint8_t)clamp32(y[kind], 0, STEP_LENGTH - 1);
}

/* Copies a few numbers. What is past their end, up to 16 numbers, may be overwritten. */
INLINE void NAMED(copy)(int32_t *restrict to, const int32_t *restrict from, int32_t count)
{
    for (int32_t i = 0; i < count; i += 16) memcpy(to + i, from + i, 4 * 16);
}

#if defined(HAS_AVX512) || defined(HAS_VNNI)
/* The mask of the first `count` lanes, or of all. */
INLINE __mmask16 NAMED(first_of)(int32_t count) { return (__mmask16)_bzhi_u32(0xffff, (uint32_t)count); }

/* SPEC 7.10: the numbers of an anchor's offsets that have symbols, three bits for each offset. */
INLINE uint64_t NAMED(kept_numbers)(const uint8_t *mask, int32_t offsets)
{
    __m128i own = _mm_maskz_loadu_epi8((__mmask16)((1u << offsets) - 1), mask);
    return _pdep_u64(_mm_test_epi8_mask(own, own), UINT64_C(0x1249249249249)) * 7;
}
#endif

/* SPEC 7.7, 7.9 and 8.5: the models of a stage, for all anchors of a chunk. steps: [n, 3], set in the first stage.
 *
 * Returns whether any value has raw bits. count: how many values there are.
 */
static int NAMED(prepare)(const kernel_scene *s, NAMED(chunk_work) *c, const stage *g, const uint8_t *masks, int64_t n,
                          uint8_t *steps, int64_t *count)
{
    const int32_t width = g->width, out = g->hyper.out, offsets = s->offset_count;
    int raw = 0;
    *count = 0;
    for (int64_t b = 0; b < n; b += BLOCK) {
        int32_t rows = n - b < BLOCK ? (int32_t)(n - b) : BLOCK, found = 0;
        NAMED(last_layer)(&g->hyper, c->deep + b * c->deep_stride, c->deep_stride, rows, c->y);
        /* SPEC 7.9: the outputs of CARM, which has as many for a slice, are added to those of F_h. */
        if (g->carm.count)
            NAMED(run_network)(&g->carm, c->seen + b * c->seen_stride, c->seen_stride, rows, c->between, c->y, 1);
        if (g->kind == OFFSET_STAGE) {
            /* SPEC 7.10: only the offsets that the masks keep have symbols. */
            for (int32_t r = 0; r < rows; r++) {
                const uint8_t *mask = masks + (b + r) * offsets;
                const int32_t *y = c->y + (int64_t)r * out;
#if defined(HAS_AVX512) || defined(HAS_VNNI)
                uint64_t kept = NAMED(kept_numbers)(mask, offsets);
                for (int32_t i = 0; i < width; i += 16, kept >>= 16) {
                    __mmask16 own = (__mmask16)kept;
                    _mm512_storeu_si512(c->mean + found, _mm512_maskz_compress_epi32(own, LOAD(y + i)));
                    _mm512_storeu_si512(c->scale + found, _mm512_maskz_compress_epi32(own, LOAD(y + width + i)));
                    found += __builtin_popcount(own);
                }
                continue;
#endif
                for (int32_t k = 0; k < offsets; k++) {
                    /* What is not kept is overwritten by the next. */
                    for (int32_t axis = 0; axis < 3; axis++) {
                        c->mean[found + axis] = y[3 * k + axis];
                        c->scale[found + axis] = y[width + 3 * k + axis];
                    }
                    found += 3 * (mask[k] != 0);
                }
            }
        } else {
            for (int32_t r = 0; r < rows; r++, found += width) {
                const int32_t *y = c->y + (int64_t)r * out;
                NAMED(copy)(c->mean + found, y, width);
                NAMED(copy)(c->scale + found, y + width, width);
                if (g->kind == SCALING_STAGE) NAMED(steps_of)(y + 2 * width, steps + KINDS * (b + r));
            }
        }
        raw |= NAMED(select)(&c->g, *count, c->mean, c->scale, found);
        *count += found;
    }
    return raw;
}

/* SPEC 7.9: what CARM reads of a slice. */
static void NAMED(see)(const kernel_scene *s, NAMED(chunk_work) *c, const stage *g, int64_t n)
{
    const int32_t width = g->width;
    int32_t shift[WIDTH_MAX + 16], half[WIDTH_MAX + 16];
    memset(shift, 0, sizeof shift);
    memset(half, 0, sizeof half);
    for (int32_t i = 0; i < width; i++) {
        shift[i] = s->carm_shift[g->first + i];
        half[i] = 1 << shift[i] >> 1;
    }
    for (int64_t r = 0; r < n; r++) {
        int16_t *to = c->seen + r * c->seen_stride + g->first;
        const int32_t *value = c->g.value + r * width;
#if defined(HAS_AVX512) || defined(HAS_VNNI)
        for (int32_t i = 0; i < width; i += 16) {
            __m512i own = _mm512_srav_epi32(_mm512_add_epi32(LOAD(value + i), LOAD(half + i)), LOAD(shift + i));
            own = _mm512_max_epi32(_mm512_min_epi32(own, _mm512_set1_epi32(ACTIVATION_MAX)),
                                   _mm512_set1_epi32(-ACTIVATION_MAX));
            _mm256_mask_storeu_epi16(to + i, NAMED(first_of)(width - i), _mm512_cvtepi32_epi16(own));
        }
#else
        for (int32_t i = 0; i < width; i++)
            to[i] = (int16_t)clamp32((value[i] + half[i]) >> shift[i], -ACTIVATION_MAX, ACTIVATION_MAX);
#endif
    }
}

/* SPEC 7.10: moves the values of a stage to the chunk, or from it if they are encoded. */
static void NAMED(move)(const kernel_scene *s, NAMED(chunk_work) *c, const stage *g, kernel_chunk *chunk, int64_t n,
                        int encode)
{
    const int32_t width = g->width, offsets = s->offset_count;
    int32_t *value = c->g.value;
    if (g->kind == SCALING_STAGE) {
        if (encode)
            memcpy(value, chunk->scalings, 4 * SCALINGS * (size_t)n);
        else
            memcpy(chunk->scalings, value, 4 * SCALINGS * (size_t)n);
    } else if (g->kind == OFFSET_STAGE) {
#if defined(HAS_AVX512) || defined(HAS_VNNI)
        for (int64_t r = 0; r < n && !encode; r++) {
            uint64_t kept = NAMED(kept_numbers)(chunk->masks + r * offsets, offsets);
            for (int32_t i = 0; i < width; i += 16, kept >>= 16) {
                __m512i own = _mm512_maskz_expand_epi32((__mmask16)kept, LOAD(value));
                _mm512_mask_storeu_epi32(chunk->offsets + r * width + i, NAMED(first_of)(width - i), own);
                value += __builtin_popcount((__mmask16)kept);
            }
        }
        if (!encode) return;
#endif
        for (int64_t i = 0; i < n * offsets; i++) {
            int32_t *own = chunk->offsets + 3 * i, kept = chunk->masks[i] != 0;
            if (encode)
                memcpy(value, own, 4 * 3 * (size_t)kept);
            else
                for (int axis = 0; axis < 3; axis++) own[axis] = kept ? value[axis] : 0;
            value += 3 * kept;
        }
    } else {
        for (int64_t r = 0; r < n; r++) {
            int32_t *own = chunk->features + r * s->features + g->first;
            int32_t *to = encode ? value + r * width : own;
            const int32_t *from = encode ? own : value + r * width;
            for (int32_t i = 0; i < width; i++) to[i] = from[i];
        }
    }
}

/* ------------------------------------------------------------------------------------------------- SPEC 5.14: chunks -- */

/* SPEC 10.1, CHUNKS: decodes a chunk. Returns its first error code, or 0. */
static int32_t NAMED(decode_chunk)(const kernel_scene *s, kernel_chunk *chunk, workspace *w)
{
    int64_t n = chunk->anchors, count;
    NAMED(chunk_work) c;
    decoder d;
    if (n < 1 || n > ANCHORS_MAX || !s->has_planes) return KERNEL_REFUSED;
    int32_t error = NAMED(decode_positions)(s, chunk, w);
    if (error) return error;
    /* The masks. */
    chunk->verdict.part = 1;
    if (!NAMED(make_room)(s, (uint64_t)n, NAMED(FOR_MASKS), chunk->length[1] / 2, 0, w, &c))
        return KERNEL_NO_MEMORY;
    error = open_decoder(&d, chunk->part[1], chunk->length[1], s->mask_lanes, c.words);
    if (error) return error;
    uint64_t kept = NAMED(code_masks)(s, &c, &d, NULL, chunk->masks, n);
    error = close_decoder(&d, &chunk->verdict);
    if (error) return error;
    /* SPEC [R6.11-11] */
    if (kept != chunk->kept) return fault(&chunk->verdict, CHUNK_KEPT, (int64_t)kept, 0);
    /* SPEC 7.10: the attributes. */
    chunk->verdict.part = 2;
    if (!NAMED(make_room)(s, (uint64_t)n, NAMED(FOR_ATTRIBUTES), chunk->length[2] / 2, 0, w, &c))
        return KERNEL_NO_MEMORY;
    error = open_decoder(&d, chunk->part[2], chunk->length[2], s->attribute_lanes, c.words);
    if (error) return error;
    NAMED(deepen)(s, &c, chunk->positions, n);
    for (int32_t i = 0; i < s->stage_count; i++) {
        const stage *g = &s->stages[i];
        int raw = NAMED(prepare)(s, &c, g, chunk->masks, n, chunk->steps, &count);
        NAMED(decode_values)(s->tables, &d, &s->tables->gauss, &c.g, count, raw, ATTRIBUTE_SYMBOL_MAX);
        NAMED(move)(s, &c, g, chunk, n, 0);
        if (g->kind == FEATURE_STAGE && i + 1 < s->stage_count) NAMED(see)(s, &c, g, n);
    }
    return close_decoder(&d, &chunk->verdict);
}

/* SPEC B.4: makes the parts of a chunk. */
static int32_t NAMED(encode_chunk)(const kernel_scene *s, kernel_chunk *chunk, workspace *w)
{
    int64_t n = chunk->anchors, count;
    NAMED(chunk_work) c;
    if (n < 1 || n > ANCHORS_MAX || !s->has_planes) return KERNEL_REFUSED;
    int32_t status = NAMED(encode_positions)(s, chunk, w);
    if (status != KERNEL_DONE) return status;
    /* The masks. */
    if (!NAMED(make_room)(s, (uint64_t)n, NAMED(FOR_MASKS), 0, 1, w, &c)) return KERNEL_NO_MEMORY;
    NAMED(code_masks)(s, &c, NULL, &c.e, chunk->masks, n);
    status = NAMED(finish_encoder)(&c.e, s->mask_lanes, c.words, &chunk->part[1], &chunk->length[1]);
    free(c.e.raw.bytes);
    if (status != KERNEL_DONE) return status;
    /* SPEC 7.10: the attributes. No stage waits for another, since the symbols are known. */
    if (!NAMED(make_room)(s, (uint64_t)n, NAMED(FOR_ATTRIBUTES), 0, 1, w, &c)) return KERNEL_NO_MEMORY;
    NAMED(deepen)(s, &c, chunk->positions, n);
    for (int32_t i = 0; i < s->stage_count && status == KERNEL_DONE; i++) {
        const stage *g = &s->stages[i];
        int raw = NAMED(prepare)(s, &c, g, chunk->masks, n, c.steps, &count);
        NAMED(move)(s, &c, g, chunk, n, 1);
        if (!NAMED(encode_values)(s->tables, &c.e, &s->tables->gauss, &c.g, count, raw, ATTRIBUTE_SYMBOL_MAX))
            status = KERNEL_REFUSED;
        if (g->kind == FEATURE_STAGE && i + 1 < s->stage_count) NAMED(see)(s, &c, g, n);
    }
    /* SPEC 7.8: the steps of the scene are those that the networks give. */
    if (status == KERNEL_DONE && memcmp(c.steps, chunk->steps, KINDS * (size_t)n)) status = KERNEL_REFUSED_STEPS;
    if (status == KERNEL_DONE)
        status = NAMED(finish_encoder)(&c.e, s->attribute_lanes, c.words, &chunk->part[2], &chunk->length[2]);
    free(c.e.raw.bytes);
    return status;
}

/* --------------------------------------------------------------------------------------------- SPEC 9.2: values -- */

/* SPEC 9.2, VALUE: a symbol times its step, rounded once. */
static void NAMED(values)(const int32_t *symbols, const uint8_t *index, int64_t stride, const float *step, int64_t rows,
                          int64_t width, float *values)
{
    for (int64_t r = 0; r < rows; r++) {
        float unit = step[index[r * stride] % STEP_LENGTH];
        for (int64_t i = 0; i < width; i++) values[r * width + i] = (float)symbols[r * width + i] * unit;
    }
}

/* ------------------------------------------------------------------------------------------- SPEC 9.4: Gaussians -- */

/* What a piece of anchors works with. value: of each kind. inputs, hidden, picked: of networks. y: of an offset. */
typedef struct {
    float *value[KINDS];
    int16_t *inputs, *hidden, *picked;
    int32_t *y;
} NAMED(splat_work);

/* SPEC 9.4, SPLAT: the Gaussians of at most BLOCK anchors. place: of each anchor, the number of its next Gaussian. */
static void NAMED(splat_block)(const splat_job *j, const NAMED(splat_work) *w, const int64_t *anchor, int64_t *place,
                               int32_t rows)
{
    const float output_unit = 1.0f / (1 << OUTPUT_BITS), scaling_unit = 1.0f / (1 << SCALING_BITS);
    const kernel_splatter *s = j->networks;
    const int32_t in = s->features, units = s->units;
    int32_t scale[BLOCK * SCALINGS], first = 0;
    uint32_t m[BLOCK][3];
    float unit[BLOCK][3];
    /* Anchors that follow each other are taken together. */
    const int32_t run = anchor[rows - 1] - anchor[0] == rows - 1 ? rows : 1, width[] = {in, SCALINGS, 3 * s->offsets};
    const void *given[KINDS] = {j->feature, j->scaling, j->offset};
    for (int kind = 0; kind < KINDS; kind++)
        for (int32_t r = 0; r < rows; r += run) {
            const int32_t *from = (const int32_t *)given[kind] + anchor[r] * width[kind];
            float *to = w->value[kind] + r * width[kind];
            if (j->steps) {
                const uint8_t *index = j->steps + KINDS * anchor[r] + kind;
                NAMED(values)(from, index, KINDS, j->step + kind * STEP_LENGTH, run, width[kind], to);
            } else {
                memcpy(to, from, 4 * (size_t)(run * width[kind]));
            }
        }
    for (int32_t i = 0; i < rows * in; i++) w->inputs[i] = (int16_t)fixed(w->value[0][i], 1, ACTIVATION_MAX);
    for (int32_t i = 0; i < rows * SCALINGS; i++) scale[i] = fixed(w->value[1][i], 1 << SCALING_BITS, SCALING_BOUND);
    for (int32_t r = 0; r < rows; r++)
        for (int i = 0; i < 3; i++) m[r][i] = exponential(scale[r * SCALINGS + i], &unit[r][i]);
    for (int n = 0; n < NETWORKS; first += s->hidden[n++].out)
        NAMED(layer_rows)(&s->hidden[n], w->inputs, in, rows, w->hidden + first, NULL, units, 0);
    for (int32_t k = 0; k < s->offsets; k++) {
        int32_t pick[BLOCK], picked = 0;
        for (int32_t r = 0; r < rows; r++) {
            pick[picked] = r;
            picked += j->mask[anchor[r] * s->offsets + k] != 0;
        }
        const layer *last = &s->last[k];
        const int16_t *hidden = picked < rows ? w->picked : w->hidden;
        for (int32_t i = 0; i < picked && picked < rows; i++)
            memcpy(w->picked + i * units, w->hidden + pick[i] * units, 2 * (size_t)units);
        NAMED(last_layer)(last, hidden, units, picked, w->y);
        for (int32_t i = 0; i < picked; i++) {
            const int32_t *y = w->y + i * last->out, r = pick[i];
            const int64_t a = anchor[r], to = place[r]++;
            float *of[COLUMNS];
            for (int c = 0; c < COLUMNS; c++) of[c] = j->to[c] + to * j->stride[c];
            for (int axis = 0; axis < 3; axis++) {
                /* ADD_F32. The 0 turns -0 into +0. */
                of[0][axis] = j->position[3 * a + axis] +
                             product(w->value[2][3 * (r * s->offsets + k) + axis], m[r][axis], unit[r][axis]) + 0.0f;
                int32_t sum = scale[r * SCALINGS + 3 + axis] + y[LENGTHS + axis] * (1 << (SCALING_BITS - OUTPUT_BITS));
                of[1][axis] = (float)sum * scaling_unit;
            }
            for (int i = 0; i < 4; i++) of[2][i] = (float)y[QUATERNION + i] * output_unit;
            if (!(y[QUATERNION] | y[QUATERNION + 1] | y[QUATERNION + 2] | y[QUATERNION + 3])) of[2][0] = 1;
            of[3][0] = (float)y[LOGIT] * output_unit;
            for (int32_t i = 0; i < s->colours; i++) of[4][i] = (float)(y + HARMONICS)[i] * output_unit;
        }
    }
}

/* The Gaussians of a piece. Returns whether there is memory. */
static int NAMED(splat)(const splat_job *j, int64_t piece, workspace *w)
{
    const kernel_splatter *s = j->networks;
    NAMED(splat_work) own;
    for (int pass = 0; pass < 2; pass++) {
        arena a = {pass ? w->base : NULL, 0};
        const int32_t width[] = {s->features, SCALINGS, 3 * s->offsets};
        for (int kind = 0; kind < KINDS; kind++) own.value[kind] = take(&a, BLOCK * (uint64_t)width[kind], 4);
        own.inputs = take(&a, (BLOCK + ROWS) * (uint64_t)s->hidden[0].in, 2);
        own.hidden = take(&a, (BLOCK + ROWS) * (uint64_t)s->units, 2);
        own.picked = take(&a, (BLOCK + ROWS) * (uint64_t)s->units, 2);
        own.y = take(&a, (BLOCK + ROWS) * (uint64_t)s->last[0].out, 4);
        if (!pass && !reserve(w, a.used)) return 0;
    }
    int64_t anchor[BLOCK], place[BLOCK], next = j->place[piece], end = (piece + 1) * PIECE;
    int32_t rows = 0;
    if (end > j->count) end = j->count;
    for (int64_t a = piece * PIECE; a < end; a++) {
        int64_t before = next;
        for (int32_t k = 0; k < s->offsets; k++) next += j->mask[a * s->offsets + k] != 0;
        anchor[rows] = a;
        place[rows] = before;
        rows += next > before;
        if (rows == BLOCK || (rows && a + 1 == end)) {
            NAMED(splat_block)(j, &own, anchor, place, rows);
            rows = 0;
        }
    }
    return 1;
}

static const struct variant NAMED(variant) = {
    TEXT(VARIANT),       {LANES, TILE_MOST},  NAMED(decode_weights), NAMED(decode_plane), NAMED(encode_plane),
    NAMED(decode_chunk), NAMED(encode_chunk), NAMED(values),         NAMED(splat),
};
