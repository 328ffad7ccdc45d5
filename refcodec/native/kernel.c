/* The native kernel: tables, networks, threads and the interface of kernel.h. The coding is in variant.h, which is
 * compiled once for each kind of vectors.
 */
#include "kernel.h"

#include <stdlib.h>
#include <string.h>

#include "module.h"

#ifndef KERNEL_THREADS
#define KERNEL_THREADS 1
#endif
#if KERNEL_THREADS
#include <pthread.h>
#endif

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the kernel reads the little-endian words of a file as they are"
#endif

#if defined(__x86_64__)
#include <cpuid.h>
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#define INLINE static inline __attribute__((always_inline))
/* A loop that has the registers for itself. */
#define ALONE static __attribute__((noinline))
/* A loop of few rounds, whose number the compiler knows, without the loop. So arrays of vectors stay in registers. */
#if defined(__clang__)
#define UNROLL _Pragma("unroll")
#else
#define UNROLL _Pragma("GCC unroll 8")
#endif

/* The names are those of SPEC.md. */
enum {
    ACTIVATION_MAX = 1023,
    LAYERS_MAX = 3,
    WIDTH_MAX = 128,
    SCALINGS = 6,
    KINDS = 3,
    OFFSETS_MAX = 16,
    CHANNELS_MAX = 16,
    FREQUENCIES_MAX = 16,
    PLANE_SIZE_MAX = 1024,
    ANCHORS_MAX = 65536,
    PLANES = 5,
    PLANE_SHIFT_MAX = 10,
    CARM_SHIFT_MAX = 16,
    EXPONENT_MAX = 20,
    LANES_MAX = 256,
    STATE_MIN = 1 << 16,
    PRECISION = 14,
    TOTAL = 1 << PRECISION,
    RAW_MAX = 16,
    ESCAPE_PREFIX_MAX = 23,
    SCALE_MIN = -40,
    SCALE_END = 24,
    FRACTIONS = 16,
    MODELS = (SCALE_END - SCALE_MIN) * FRACTIONS,
    SINE_LENGTH = 1024,
    STEP_LENGTH = 64,
    UNIT = 1 << 16,
    MATRIX_BOUND = 1 << 20,
    FRAME_SHIFT_MAX = 60,
    FRAME_RANGE_BOUND = 1 << 18,
    FRAME_CLAMP = (1 << 30) - 1,
    ATTRIBUTE_SYMBOL_MAX = (1 << 23) - 1,
    WEIGHT_SYMBOL_MAX = (1 << 24) - 1,
    PLANE_SYMBOL_MAX = (1 << 15) - 1,
    HARMONICS_MAX = 48,
    OUTPUT_BITS = 12,
    SCALING_BITS = 16,
    SCALING_BOUND = 27 << SCALING_BITS,
    LOG2_E = 1549082005,
    /* The terms of the exponential. */
    TERMS = 7,
    CELL_LEVELS = 16,
    CELL_INDEX = 40,
    CELL_MIDDLE = 1 << 15,
    POSITION_MODELS = 18,
    HALVES = 16,
    SUBSTREAM_HEAD = 8,
    RAW_POSITION = 6,
};

static const int64_t TRANSLATION_BOUND = INT64_C(1) << 61;

/* The error codes of SPEC 10.3 that a chunk or a substream can have. */
enum {
    CHUNK_KEPT = 446,
    CHUNK_BOUNDS = 447,
    NOT_FINITE = 451,
    NEGATIVE_ZERO = 452,
    CELL_COUNT = 453,
    CELL_NUMBER = 454,
    SUBSTREAM_LENGTH = 501,
    SUBSTREAM_STATE = 502,
    SUBSTREAM_WORDS = 503,
    SUBSTREAM_FINAL_STATE = 504,
    SUBSTREAM_ESCAPE = 505,
    SUBSTREAM_RANGE = 506,
    SUBSTREAM_RAW_LENGTH = 507,
    SUBSTREAM_RAW_PADDING = 508,
    SUBSTREAM_CRC = 509,
};

/* Rows of anchors that go through the networks together, so that their numbers stay in the first-level cache. */
enum { BLOCK = 64 };
/* Outputs of a layer are padded to a multiple of this, and rows to a multiple of the next. */
enum { OUTPUTS = 16, ROWS = 8 };
/* SPEC 9.4: the rendering networks of a static scene. Together they have the most pairs of inputs of a layer. */
enum { NETWORKS = 3, PAIRS_MAX = NETWORKS * WIDTH_MAX / 2 };

static int64_t round_up(int64_t a, int64_t unit) { return (a + unit - 1) / unit * unit; }

/* ------------------------------------------------------------------------------------------------------- memory -- */

/* Arrays that are laid out one behind the other in one block. A first pass with base NULL only counts the bytes. */
typedef struct {
    uint8_t *base;
    uint64_t used;
} arena;

static void *take(arena *a, uint64_t count, uint64_t size)
{
    /* All counts are bounded by SPEC 11.1, so that 64 bits hold every sum. Vectors may read past an array's end. */
    uint64_t at = a->used;
    a->used += (count * size + 2 * 64 + 63) / 64 * 64;
    return a->base ? a->base + at : NULL;
}

/* The working memory of a thread. It grows, and is used again for the next chunk. */
typedef struct {
    void *block;
    uint8_t *base;
    uint64_t size;
} workspace;

/* Returns whether the workspace has so many bytes now. What they hold is not known. */
static int reserve(workspace *w, uint64_t size)
{
    if (size <= w->size) return 1;
    free(w->block);
    w->size = 0;
    if (size > SIZE_MAX - 64) return w->block = NULL, 0;
    w->block = malloc((size_t)size + 64);
    if (!w->block) return 0;
    w->base = (uint8_t *)(((uintptr_t)w->block + 63) / 64 * 64);
    w->size = size;
    return 1;
}

/* Bytes that grow at their end. failed: whether memory ran out. */
typedef struct {
    uint8_t *bytes;
    uint64_t length, room;
    int failed;
} buffer;

static int buffer_reserve(buffer *b, uint64_t more)
{
    if (b->failed) return 0;
    if (b->length + more <= b->room) return 1;
    uint64_t room = b->length + more + b->length / 2 + 256;
    uint8_t *bytes = room > SIZE_MAX ? NULL : realloc(b->bytes, (size_t)room);
    if (!bytes) return b->failed = 1, 0;
    b->bytes = bytes;
    b->room = room;
    return 1;
}

INLINE uint32_t load32(const void *from)
{
    uint32_t value;
    memcpy(&value, from, 4);
    return value;
}

INLINE uint64_t load64(const void *from)
{
    uint64_t value;
    memcpy(&value, from, 8);
    return value;
}

INLINE void store32(void *to, uint32_t value) { memcpy(to, &value, 4); }

/* ------------------------------------------------------------------------------------------------------- CRC-32 -- */

/* SPEC 2.4: CRC-32 by eight tables. table[t][n] is the remainder of byte n with t zero bytes behind it. */
static void make_crc_table(uint32_t table[8][256])
{
    for (uint32_t n = 0; n < 256; n++) {
        uint32_t c = n;
        for (int bit = 0; bit < 8; bit++) c = c & 1 ? 0xEDB88320u ^ c >> 1 : c >> 1;
        table[0][n] = c;
    }
    for (int t = 1; t < 8; t++)
        for (int n = 0; n < 256; n++) table[t][n] = table[0][table[t - 1][n] & 255] ^ table[t - 1][n] >> 8;
}

/* c is the register: the complement of a CRC-32. */
static uint32_t crc_bytes(const uint32_t table[8][256], uint32_t c, const uint8_t *p, uint64_t n)
{
    for (; n >= 8; n -= 8, p += 8) {
        uint64_t v = load64(p) ^ c;
        c = table[7][v & 255] ^ table[6][v >> 8 & 255] ^ table[5][v >> 16 & 255] ^ table[4][v >> 24 & 255] ^
            table[3][v >> 32 & 255] ^ table[2][v >> 40 & 255] ^ table[1][v >> 48 & 255] ^ table[0][v >> 56];
    }
    while (n--) c = table[0][(c ^ *p++) & 255] ^ c >> 8;
    return c;
}

/* ------------------------------------------------------------------------------------------------------- models -- */

/* SPEC 8.2 and 8.4: models. Each has room for PLACES symbols. Symbol s of a model stands at the place MIDDLE - R + s,
 * so that the place of a value says how far it is from the centre. R is 0 for models that are not of values.
 *
 * first: for each model and the top 8 bits of a slot, the place of the first symbol that the slot can mean.
 * radius: R of each model.
 * entry: for each model and place, the symbol's lowest slot, and above 16 bits its frequency. ESCAPE: it is no value.
 */
typedef struct {
    uint8_t *first, *radius;
    uint32_t *entry;
} models;

enum { SLOT_TOP = 256, SLOT_SHIFT = PRECISION - 8, PLACES = 256, MIDDLE = 128, RADIUS_MAX = 126, ESCAPE = 1 << 15 };

/* Adds model number `index`. escape: whether its last symbol is the escape. Returns whether it is a model. */
static int add_model(models *m, uint32_t index, const uint16_t *frequency, uint32_t count, uint32_t radius, int escape)
{
    uint32_t low = 0, *entry = m->entry + index * PLACES + MIDDLE - radius;
    m->radius[index] = (uint8_t)radius;
    for (uint32_t symbol = 0; symbol < count; symbol++) {
        entry[symbol] = low | (uint32_t)frequency[symbol] << 16;
        low += frequency[symbol];
    }
    if (low != TOTAL) return 0;
    for (uint32_t top = 0, symbol = 0; top < SLOT_TOP; top++) {
        uint32_t slot = top << SLOT_SHIFT;
        while ((entry[symbol] & 0xffff) + (entry[symbol] >> 16) <= slot) symbol++;
        m->first[index * SLOT_TOP + top] = (uint8_t)(MIDDLE - radius + symbol);
    }
    if (escape) entry[count - 1] |= ESCAPE;
    return 1;
}

/* Lays out `count` models. */
static void take_models(arena *a, models *m, uint64_t count)
{
    m->first = take(a, count * SLOT_TOP, 1);
    m->radius = take(a, count, 1);
    m->entry = take(a, count * PLACES, 4);
}

struct kernel_tables {
    uint32_t crc[8][256];
    /* SPEC A.1: for each part of a turn its sine, and above 16 bits its cosine. */
    uint32_t turn[SINE_LENGTH];
    models gauss, laplace;
    /* For each set of eight lanes, how many lanes of the set come before each lane. */
    uint8_t before[256][8];
    void *block;
};

/* SPEC A: the sine, the steps, and two families of models: a byte R, then 2 R + 2 frequencies. */
KERNEL_API kernel_tables *kernel_tables_new(const uint8_t *file, uint64_t length)
{
    const uint64_t start = 2 * SINE_LENGTH + 2 * STEP_LENGTH;
    uint64_t at = start;
    for (int i = 0; i < 2 * MODELS; i++) {
        if (at >= length || file[at] > RADIUS_MAX) return NULL;
        uint64_t size = 2 * (2 * (uint64_t)file[at] + 2);
        if (length - at - 1 < size) return NULL;
        at += 1 + size;
    }
    if (at != length) return NULL;
    kernel_tables *t = NULL;
    arena a = {NULL, 0};
    for (int pass = 0; pass < 2; pass++) {
        models gauss, laplace;
        kernel_tables *own = take(&a, 1, sizeof *t);
        take_models(&a, &gauss, MODELS);
        take_models(&a, &laplace, MODELS);
        if (pass) {
            t = own;
            t->gauss = gauss;
            t->laplace = laplace;
            break;
        }
        /* Gathers of four bytes read a little past a table, which take() leaves room for. */
        uint8_t *block = calloc(1, (size_t)a.used + 64);
        if (!block) return NULL;
        a.base = (uint8_t *)(((uintptr_t)block + 63) / 64 * 64);
        a.used = 0;
        ((kernel_tables *)a.base)->block = block;
    }
    make_crc_table(t->crc);
    uint16_t sine[SINE_LENGTH];
    memcpy(sine, file, sizeof sine);
    for (uint32_t i = 0; i < SINE_LENGTH; i++)
        t->turn[i] = sine[i] | (uint32_t)sine[(i + SINE_LENGTH / 4) % SINE_LENGTH] << 16;
    for (int set = 0; set < 256; set++)
        for (int lane = 1; lane < 8; lane++)
            t->before[set][lane] = (uint8_t)(t->before[set][lane - 1] + (set >> (lane - 1) & 1));
    at = start;
    for (int family = 0; family < 2; family++)
        for (uint32_t i = 0; i < MODELS; i++) {
            uint32_t radius = file[at], count = 2 * radius + 2;
            uint16_t frequency[2 * RADIUS_MAX + 2];
            memcpy(frequency, file + at + 1, 2 * (size_t)count);
            if (!add_model(family ? &t->laplace : &t->gauss, i, frequency, count, radius, 1))
                return kernel_tables_free(t), NULL;
            at += 1 + 2 * (uint64_t)count;
        }
    return t;
}

KERNEL_API void kernel_tables_free(kernel_tables *tables)
{
    if (tables) free(tables->block);
}

/* ----------------------------------------------------------------------------------------------------- networks -- */

/* Outputs of a layer that are computed together, from those pairs of inputs that have a weight in them.
 *
 * first: the first output. vectors: of outputs. pair: [count]. weight: [count, outputs, 2].
 */
typedef struct {
    int32_t first, vectors, count;
    uint8_t *pair;
    int16_t *weight;
} tile;

/* SPEC 7.2: a layer of integers, for products of pairs.
 *
 * in, out: padded, in to an even number and out to a multiple of OUTPUTS. What is padded has the weight 0.
 * tile: [tiles]. bias: [out], with half a unit of the shift. shift: [out].
 */
typedef struct {
    int32_t in, out, tiles;
    tile *tile;
    int32_t *bias, *shift;
} layer;

/* Of a kind of vectors: outputs of a vector, and the most vectors of a tile. */
typedef struct {
    int32_t lanes, most;
} tiling;

/* A layer as the description has it. */
typedef struct {
    int32_t in, out;
    const int16_t *weight;
    const int32_t *bias;
    const uint8_t *exponent;
} plain_layer;

typedef struct {
    int32_t count;
    layer layers[LAYERS_MAX];
} network;

/* Returns how many pairs of inputs vectors of outputs have. used: by each vector. pair: where to list them, or NULL. */
static int32_t pairs_of(uint8_t (*used)[PAIRS_MAX], int32_t vectors, int32_t all, uint8_t *pair)
{
    int32_t count = 0;
    for (int32_t i = 0; i < all; i++) {
        int any = 0;
        for (int32_t z = 0; z < vectors; z++) any |= used[z][i];
        if (any && pair) pair[count] = (uint8_t)i;
        count += any;
    }
    return count;
}

/* Packs some outputs of a layer, those of `rows` [count], or all if it is NULL. */
static layer pack(arena *a, tiling by, const plain_layer *from, const int32_t *rows, int32_t count)
{
    layer to = {.in = (int32_t)round_up(from->in, 2), .out = (int32_t)round_up(count, OUTPUTS)};
    const int32_t vectors = to.out / by.lanes, all = to.in / 2;
    to.tile = take(a, (uint64_t)vectors, sizeof *to.tile);
    int16_t *weight = take(a, (uint64_t)to.in * (uint64_t)to.out, 2);
    uint8_t *pair = take(a, (uint64_t)vectors * (uint64_t)all, 1);
    to.bias = take(a, (uint64_t)to.out, 4);
    to.shift = take(a, (uint64_t)to.out, 4);
    if (!a->base) return to;
    uint8_t used[4 * WIDTH_MAX / 4][PAIRS_MAX] = {{0}};
    for (int32_t o = 0; o < count; o++) {
        int32_t row = rows ? rows[o] : o, shift = from->exponent[row];
        to.bias[o] = from->bias[row] + (shift ? 1 << (shift - 1) : 0);
        to.shift[o] = shift;
        const int16_t *own = from->weight + (int64_t)row * from->in;
        for (int32_t i = 0; i < from->in; i++) used[o / by.lanes][i / 2] |= own[i] != 0;
    }
    /* Tiles of about the same size, as few as there can be, or more if that saves loads: of weights, and of inputs. */
    int64_t least = INT64_MAX;
    for (int32_t n = (vectors + by.most - 1) / by.most; n <= vectors; n++) {
        int64_t loads = 0;
        for (int32_t t = 0; t < n; t++) {
            int32_t first = vectors * t / n, size = vectors * (t + 1) / n - first;
            loads += (int64_t)pairs_of(used + first, size, all, NULL) * (size + 1);
        }
        if (loads < least) least = loads, to.tiles = n;
    }
    for (int32_t t = 0; t < to.tiles; t++) {
        int32_t first = vectors * t / to.tiles, size = vectors * (t + 1) / to.tiles - first, width = size * by.lanes;
        to.tile[t] = (tile){first * by.lanes, size, pairs_of(used + first, size, all, pair), pair, weight};
        for (const uint8_t *end = pair + to.tile[t].count; pair < end; pair++, weight += 2 * width)
            for (int32_t o = 0; o < width && to.tile[t].first + o < count; o++) {
                int32_t row = rows ? rows[to.tile[t].first + o] : to.tile[t].first + o;
                for (int32_t i = 2 * *pair; i < 2 * *pair + 2 && i < from->in; i++)
                    weight[2 * o + i % 2] = from->weight[(int64_t)row * from->in + i];
            }
    }
    return to;
}

/* -------------------------------------------------------------------------------------------------------- scene -- */

enum { SCALING_STAGE, OFFSET_STAGE, FEATURE_STAGE };

/* SPEC 7.10: one group of values of the attributes: the scalings, the offsets, or a slice of the features.
 *
 * first: of a slice, its first channel. width: the channels of the stage.
 * hyper: the outputs of F_h that it needs: means, scale indices, and with the scalings the three step indices.
 * carm: of a slice from the second on. Its count is 0 otherwise.
 */
typedef struct {
    int32_t kind, first, width;
    layer hyper;
    network carm;
} stage;

struct kernel_scene {
    const kernel_tables *tables;
    const struct variant *variant;
    int32_t offset_count, features, width, channels, plane_size, frequencies, plane_shift, inputs;
    int32_t plane_lanes, mask_lanes, attribute_lanes, cell_shift;
    /* SPEC 7.7: the hidden layers of F_h. Its output layer is in the stages. */
    network hidden, sarm;
    int32_t stage_count;
    stage stages[2 + KERNEL_SLICES_MAX];
    uint8_t carm_shift[WIDTH_MAX];
    int has_frame, has_planes;
    int64_t matrix[9], translation[3], shift[3];
    int32_t low[3], high[3];
    /* SPEC 7.3: the planes of r = 1 and r = 2, [size, size, channels]. */
    int16_t *joined[2];
    /* SPEC 5.11: of each context of a mask, the frequency of "kept". */
    uint16_t *kept;
    models cells;
    void *block;
};

/* --------------------------------------------------------------------------------------------------- substreams -- */

/* SPEC 5.15: a substream that is decoded.
 *
 * words: a copy with zeros behind it. at: how many words were taken, which may be more than there are.
 * raw_at: how many raw bits were read, which may be more than there are.
 * past, limit: if bad_range, the first symbol past its limit, and that limit.
 */
typedef struct {
    uint32_t state[LANES_MAX];
    int32_t lanes;
    uint16_t *words;
    uint64_t count, at;
    const uint8_t *raw;
    uint64_t raw_length, raw_at;
    uint32_t expected, crc;
    int bad_escape, bad_range;
    int64_t past;
    int32_t limit;
} decoder;

/* How many zero words stand behind the words: as many as one vector reads. */
enum { WORDS_PAST = 32 };

/* SPEC 5.15 and 8.1: opens a substream. words: room for its words and WORDS_PAST more. Returns an error code or 0. */
static int32_t open_decoder(decoder *d, const uint8_t *part, uint64_t length, int32_t lanes, uint16_t *words)
{
    uint64_t words_at = SUBSTREAM_HEAD + 4 * (uint64_t)lanes;
    /* SPEC [R8.1-1] */
    if (length < words_at) return SUBSTREAM_LENGTH;
    d->lanes = lanes;
    d->expected = load32(part);
    d->count = load32(part + 4);
    uint64_t raw_at = words_at + 2 * d->count;
    if (length < raw_at) return SUBSTREAM_LENGTH;
    /* SPEC [R8.1-2] */
    memcpy(d->state, part + SUBSTREAM_HEAD, 4 * (size_t)lanes);
    for (int32_t lane = 0; lane < lanes; lane++)
        if (d->state[lane] < STATE_MIN) return SUBSTREAM_STATE;
    memcpy(words, part + words_at, 2 * (size_t)d->count);
    memset(words + d->count, 0, 2 * WORDS_PAST);
    d->words = words;
    d->raw = part + raw_at;
    d->raw_length = length - raw_at;
    d->at = d->raw_at = 0;
    d->crc = 0;
    d->bad_escape = d->bad_range = 0;
    d->past = d->limit = 0;
    return 0;
}

/* Sets the numbers of an error. Returns its code. */
static int32_t fault(kernel_verdict *v, int32_t code, int64_t first, int64_t second)
{
    v->number[0] = first;
    v->number[1] = second;
    return code;
}

/* SPEC 8.8: the checks at the end of a substream, in their order. Returns the first error code, or 0. */
static int32_t close_decoder(const decoder *d, kernel_verdict *v)
{
    const int64_t raw = (int64_t)d->raw_at;
    if (d->at != d->count) return fault(v, SUBSTREAM_WORDS, (int64_t)d->at, 0);
    for (int32_t lane = 0; lane < d->lanes; lane++)
        if (d->state[lane] != STATE_MIN) return fault(v, SUBSTREAM_FINAL_STATE, lane, d->state[lane]);
    if (d->bad_escape) return SUBSTREAM_ESCAPE;
    if (d->bad_range) return fault(v, SUBSTREAM_RANGE, d->past, d->limit);
    if (d->raw_length != (d->raw_at + 7) / 8) return fault(v, SUBSTREAM_RAW_LENGTH, raw, 0);
    if (d->raw_at % 8 && d->raw[d->raw_length - 1] >> d->raw_at % 8) return fault(v, SUBSTREAM_RAW_PADDING, raw, 0);
    if (d->crc != d->expected) return fault(v, SUBSTREAM_CRC, d->crc, 0);
    return 0;
}

/* SPEC 8.3: a state with a word behind it if it needs one. No branch guesses whether it does. */
INLINE uint32_t fed(uint32_t x, uint32_t word)
{
    uint32_t hungry = x < STATE_MIN;
    return x << (hungry << 4) | (word & (0u - hungry));
}

/* SPEC 8.6: the next raw bits, at least 57 of them. Bits past the end are 0. */
INLINE uint64_t raw_window(const decoder *d)
{
    uint64_t byte = d->raw_at >> 3, window = 0;
    if (byte + 8 <= d->raw_length)
        window = load64(d->raw + byte);
    else
        for (int i = 0; i < 8 && byte + (uint64_t)i < d->raw_length; i++)
            window |= (uint64_t)d->raw[byte + (uint64_t)i] << 8 * i;
    return window >> (d->raw_at & 7);
}

/* SPEC 8.7: reads an escape, and returns how far its value is from the centre, with its sign. */
static int32_t read_escape(decoder *d, int32_t radius)
{
    uint64_t window = raw_window(d);
    int negative = window & 1;
    int32_t n = 1;
    uint32_t prefix = 0;
    window >>= 1;
    while (prefix <= ESCAPE_PREFIX_MAX && !(window >> prefix & 1)) prefix++;
    if (prefix > ESCAPE_PREFIX_MAX) {
        /* SPEC [R8.7-1] */
        d->bad_escape = 1;
        d->raw_at += 1 + prefix;
    } else {
        n = (int32_t)((1u << prefix) + (uint32_t)(window >> (prefix + 1) & ((UINT64_C(1) << prefix) - 1)));
        d->raw_at += 2 + 2 * prefix;
    }
    return negative ? -(radius + n) : radius + n;
}

/* A group of symbols.
 *
 * model: of each symbol. centre, width: of each value, its centre and its number of raw bits. value: the symbols.
 * escape: the numbers of the values that are escaped.
 */
typedef struct {
    uint16_t *model;
    int32_t *centre;
    uint8_t *width;
    int32_t *value;
    int32_t *escape;
} group;

static void take_group(arena *a, group *g, uint64_t count)
{
    g->model = take(a, count, 2);
    g->centre = take(a, count, 4);
    g->width = take(a, count, 1);
    g->value = take(a, count, 4);
    g->escape = take(a, count, 4);
}

/* SPEC B.4: a substream that is encoded. Symbols are kept until the end, since rANS runs backwards.
 *
 * symbol: the entry of each symbol in its models. ends: of each group, how many symbols there are with it.
 * raw: the raw bytes that are full. bits, bit_count: what follows them. crc: as in a decoder.
 */
typedef struct {
    uint32_t *symbol;
    uint64_t count;
    uint64_t *ends;
    int32_t groups;
    buffer raw;
    uint64_t bits;
    uint32_t bit_count;
    uint32_t crc;
} encoder;

/* SPEC 8.6: appends raw bits, at most 32. */
static void put_bits(encoder *e, uint32_t value, uint32_t count)
{
    e->bits |= (uint64_t)value << e->bit_count;
    e->bit_count += count;
    if (e->bit_count >= 8 && !buffer_reserve(&e->raw, 8)) e->bit_count = 0;
    while (e->bit_count >= 8) {
        e->raw.bytes[e->raw.length++] = (uint8_t)e->bits;
        e->bits >>= 8;
        e->bit_count -= 8;
    }
}

/* SPEC 8.7: appends an escape. away: how far the value is from its centre, more than radius. */
static void put_escape(encoder *e, int32_t away, int32_t radius)
{
    uint32_t n = (uint32_t)((away < 0 ? -away : away) - radius), prefix = 31 - (uint32_t)__builtin_clz(n);
    put_bits(e, away < 0, 1);
    put_bits(e, 1u << prefix, prefix + 1);
    put_bits(e, n - (1u << prefix), prefix);
}

/* ----------------------------------------------------------------------------------------------------- geometry -- */

/* SPEC 7.4, POSITION_INTEGER. */
INLINE int64_t position_integer(uint32_t bits)
{
    uint32_t e = bits >> 10 & 31, normal = e > 0;
    int64_t p = (int64_t)((bits & 1023) + (normal << 10)) << (e - normal);
    return bits >> 15 ? -p : p;
}

/* The largest integer that is not above x, for |x| < 2^31. */
INLINE double floor32(double x)
{
    double cut = (double)(int32_t)x;
    return cut > x ? cut - 1 : cut;
}

INLINE int64_t clamp64(int64_t a, int64_t low, int64_t high) { return a < low ? low : a > high ? high : a; }
INLINE int32_t clamp32(int32_t a, int32_t low, int32_t high) { return a < low ? low : a > high ? high : a; }

/* SPEC 7.12: the low 16 of every third bit of a code. */
static uint32_t every_third(uint64_t v)
{
    v &= UINT64_C(0x1249249249249249);
    v = (v ^ v >> 2) & UINT64_C(0x10c30c30c30c30c3);
    v = (v ^ v >> 4) & UINT64_C(0x100f00f00f00f00f);
    v = (v ^ v >> 8) & UINT64_C(0x1f0000ff0000ff);
    v = (v ^ v >> 16) & UINT64_C(0x1f00000000ffff);
    return (uint32_t)(v ^ v >> 32) & 0xffff;
}

/* The reverse: the 16 bits of v, each at every third place. */
static uint64_t to_thirds(uint64_t v)
{
    v = (v | v << 32) & UINT64_C(0x1f00000000ffff);
    v = (v | v << 16) & UINT64_C(0x1f0000ff0000ff);
    v = (v | v << 8) & UINT64_C(0x100f00f00f00f00f);
    v = (v | v << 4) & UINT64_C(0x10c30c30c30c30c3);
    return (v | v << 2) & UINT64_C(0x1249249249249249);
}

/* SPEC 7.12, CELL_NUMBER: the fp16 of a cell, or -1 if there is none. */
static int32_t cell_number(uint32_t cell, int32_t cell_shift)
{
    int64_t n = (int64_t)cell - CELL_MIDDLE, bits = n < 0 ? -n : n;
    if (cell_shift < CELL_INDEX) {
        int64_t p = bits << cell_shift, e = 0;
        /* The exponent that leaves eleven bits. */
        if (p >> 11) e = 53 - __builtin_clzll((unsigned long long)p);
        if (p >> e << e != p) return -1;
        bits = (e << 10) + (p >> e);
    }
    if (bits >= 0x7C00) return -1;
    return (int32_t)(n < 0 ? bits | 0x8000 : bits);
}

/* SPEC 7.12: the cell of an fp16, or -1 if it has none. */
static int32_t cell_of(uint32_t bits, int32_t cell_shift)
{
    if (cell_shift == CELL_INDEX)
        return CELL_MIDDLE + (bits >> 15 ? -(int32_t)(bits & 0x7FFF) : (int32_t)bits);
    int64_t p = position_integer(bits), n = p >> cell_shift;
    return n * (INT64_C(1) << cell_shift) == p && n >= -CELL_MIDDLE && n < CELL_MIDDLE ? (int32_t)n + CELL_MIDDLE : -1;
}

/* A number that orders fp16 as their values do. */
INLINE int32_t fp16_order(uint32_t bits) { return bits >> 15 ? -(int32_t)(bits & 0x7FFF) : (int32_t)bits; }

/* ------------------------------------------------------------------------------------------- SPEC 9.4: Gaussians -- */

/* The outputs of an offset: of opacity, covariance and colour. The last ones begin with a whole vector. */
enum { LOGIT, LENGTHS, QUATERNION = 4, HARMONICS = OUTPUTS, OUTPUTS_MAX = HARMONICS + HARMONICS_MAX };
/* The arrays of Gaussians. */
enum { COLUMNS = 5 };
/* Anchors that a thread takes at once. */
enum { PIECE = 1024 };

/* hidden: of each network, the units up to the last that has a weight behind it. last: of all networks, for an offset.
 * units: of all networks.
 */
struct kernel_splatter {
    const struct variant *variant;
    int32_t features, offsets, colours, units;
    layer hidden[NETWORKS], last[OFFSETS_MAX];
};

/* The arguments of kernel_splat. place: of each piece, the number of its first Gaussian. */
typedef struct {
    const kernel_splatter *networks;
    int64_t count, *place;
    const uint8_t *mask, *steps;
    const float *position, *step;
    const void *feature, *scaling, *offset;
    float *to[COLUMNS];
    uint32_t stride[COLUMNS];
} splat_job;

/* SPEC 2.4, ROUND_SCALED for a float and a power of two, limited to a bound below 2^23. It has no branch, so that the
 * compiler makes vectors. NaN, which no file gives, counts as infinite.
 */
INLINE int32_t fixed(float x, float unit, float bound)
{
    float y = x * unit;
    uint32_t bits = load32(&y), most = load32(&bound), sign = bits & UINT32_C(1) << 31, size = bits ^ sign;
    store32(&y, sign | (size < most ? size : most));
    int32_t n = (int32_t)y;
    float rest = y - (float)n;
    return n + (rest >= 0.5f) - (rest < -0.5f);
}

/* SPEC 9.4, EXPONENTIAL: returns m, and sets 2^n. */
INLINE uint32_t exponential(int32_t t, float *unit)
{
    static const uint32_t terms[TERMS] = {1073741824, 744260848, 257945537, 59571654, 10398739, 1330132, 234908};
    int64_t y = (int64_t)t * LOG2_E;
    uint32_t fraction = (uint32_t)((y & ((INT64_C(1) << 46) - 1)) >> 16), m = terms[TERMS - 1];
    UNROLL for (int i = TERMS - 2; i >= 0; i--) m = terms[i] + (uint32_t)((uint64_t)m * fraction >> 30);
    store32(unit, (uint32_t)((y >> 46) - 30 + 127) << 23);
    return m;
}

/* SPEC 9.4: ROUND_F32 of x * m * unit. Other numbers than those of 9.2 give any number. */
INLINE float product(float x, uint32_t m, float unit)
{
    uint32_t bits = load32(&x), exponent = bits >> 23 & 255;
    if (exponent == 0) return 0;
    int64_t own = (int64_t)((uint64_t)((bits & 0x7fffff) | 0x800000) * m);
    /* The conversion rounds. The product with powers of two is exact: an offset is 0 or at least 2^-64. */
    float rounded = (float)(bits >> 31 ? -own : own);
    uint64_t scale = (uint64_t)(exponent - 150 + 1023) << 52;
    double power;
    memcpy(&power, &scale, sizeof scale);
    return (float)((double)rounded * power * (double)unit);
}

/* ----------------------------------------------------------------------------------------------------- variants -- */

/* What variant.h gives for one kind of vectors. */
struct variant {
    const char *name;
    tiling by;
    int32_t (*decode_weights)(const kernel_tables *, decoder *, const uint8_t *, const uint64_t[2], int32_t *);
    int32_t (*decode_plane)(const kernel_scene *, const uint8_t *, uint64_t, int16_t *, workspace *, kernel_verdict *);
    int32_t (*encode_plane)(const kernel_scene *, const int16_t *, uint8_t **, uint64_t *, workspace *);
    int32_t (*decode_chunk)(const kernel_scene *, kernel_chunk *, workspace *);
    int32_t (*encode_chunk)(const kernel_scene *, kernel_chunk *, workspace *);
    void (*values)(const int32_t *, const uint8_t *, int64_t, const float *, int64_t, int64_t, float *);
    int (*splat)(const splat_job *, int64_t, workspace *);
};

#define JOIN_(a, b) a##_##b
#define JOIN(a, b) JOIN_(a, b)
#define NAMED(name) JOIN(name, VARIANT)
#define TEXT_(a) #a
#define TEXT(a) TEXT_(a)

#define VARIANT plain
#include "variant.h"
#undef VARIANT

#if defined(__x86_64__)
/* Everything between BEGIN and END may use the instructions of a target. */
#define PRAGMA(text) _Pragma(#text)
#if defined(__clang__)
#define BEGIN(names) PRAGMA(clang attribute push(__attribute__((target(names))), apply_to = function))
#define END PRAGMA(clang attribute pop)
#else
#define BEGIN(names) PRAGMA(GCC push_options) PRAGMA(GCC target(names))
#define END PRAGMA(GCC pop_options)
#endif

BEGIN("avx2,bmi,bmi2,fma,popcnt,lzcnt,pclmul")
#define VARIANT avx2
#define HAS_AVX2 1
#include "variant.h"
#undef HAS_AVX2
#undef VARIANT
END

BEGIN("avx2,bmi,bmi2,fma,popcnt,lzcnt,pclmul,avx512f,avx512bw,avx512dq,avx512vl")
#define VARIANT avx512
#define HAS_AVX512 1
#include "variant.h"
#undef VARIANT
END

BEGIN("avx2,bmi,bmi2,fma,popcnt,lzcnt,pclmul,avx512f,avx512bw,avx512dq,avx512vl,avx512vnni")
#define VARIANT avx512vnni
#define HAS_VNNI 1
#include "variant.h"
#undef VARIANT
END
#elif defined(__aarch64__)
#define VARIANT neon
#define HAS_NEON 1
#include "variant.h"
#undef VARIANT
#endif

static const struct variant *const variants[] = {
    &variant_plain,
#if defined(__x86_64__)
    &variant_avx2,
    &variant_avx512,
    &variant_avx512vnni,
#elif defined(__aarch64__)
    &variant_neon,
#endif
};
enum { VARIANTS = sizeof variants / sizeof variants[0] };

KERNEL_API int32_t kernel_version(void) { return KERNEL_VERSION; }

KERNEL_API const char *kernel_variant_name(int32_t variant)
{
    return variant >= 0 && variant < VARIANTS ? variants[variant]->name : NULL;
}

#if defined(__x86_64__)
/* Bits of XCR0: XMM and YMM, and all of AVX-512. */
enum { YMM_SAVED = 0x06, ZMM_SAVED = 0xe6 };

/* Registers that state what the processor has: ECX of leaf 1, EBX and ECX of leaf 7, ECX of leaf 0x80000001. */
typedef struct {
    uint32_t basic, extended, extended_more, later;
    /* XCR0: the registers that the operating system saves. 0 if it has not enabled XGETBV. */
    uint32_t saved;
} registers;

/* The compiler's own test, __builtin_cpu_supports, needs a run-time library, which may be missing and find nothing. */
static registers read_registers(void)
{
    registers r = {0, 0, 0, 0, 0};
    uint32_t eax, ebx, ecx, edx;
    if (__get_cpuid(1, &eax, &ebx, &ecx, &edx)) r.basic = ecx;
    if (__get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx)) r.extended = ebx, r.extended_more = ecx;
    if (__get_cpuid(0x80000001, &eax, &ebx, &ecx, &edx)) r.later = ecx;
    if (r.basic & bit_OSXSAVE) __asm__ volatile("xgetbv" : "=a"(r.saved), "=d"(edx) : "c"(0));
#if defined(__APPLE__)
    /* macOS saves the registers of AVX-512 from their first use on, and states them only then. */
    if ((r.saved & YMM_SAVED) == YMM_SAVED) r.saved |= ZMM_SAVED;
#endif
    return r;
}

static int32_t has(uint32_t found, uint32_t wanted) { return (found & wanted) == wanted; }

/* Returns the number of the best variant. Each needs all that the one before it needs. */
static int32_t best_variant(registers r)
{
    const uint32_t vectors = bit_AVX512F | bit_AVX512BW | bit_AVX512DQ | bit_AVX512VL;
    int32_t avx2 = has(r.basic, bit_OSXSAVE | bit_AVX | bit_FMA | bit_POPCNT | bit_PCLMUL) && has(r.later, bit_LZCNT) &&
                   has(r.extended, bit_AVX2 | bit_BMI | bit_BMI2) && has(r.saved, YMM_SAVED);
    int32_t avx512 = avx2 && has(r.extended, vectors) && has(r.saved, ZMM_SAVED);
    return avx2 + avx512 + (avx512 && has(r.extended_more, bit_AVX512VNNI));
}
#endif

KERNEL_API int32_t kernel_variant_runs(int32_t variant)
{
    if (variant < 0 || variant >= VARIANTS) return 0;
#if defined(__x86_64__)
    /* Asked once: a virtual machine needs up to 0.2 ms for the answer. All threads would find the same. */
    static int32_t known = -1;
    int32_t best = __atomic_load_n(&known, __ATOMIC_RELAXED);
    if (best < 0) __atomic_store_n(&known, best = best_variant(read_registers()), __ATOMIC_RELAXED);
    return variant <= best;
#else
    return 1;
#endif
}

/* ------------------------------------------------------------------------------------------- scenes, opened once -- */

/* SPEC 11.1: whether the numbers of a description are allowed, so that all sizes are small. */
static int allowed(const kernel_description *d)
{
    int64_t features = 0;
    const int32_t lanes[3] = {d->plane_lanes, d->mask_lanes, d->attribute_lanes};
    for (int i = 0; i < 3; i++)
        if (lanes[i] < 1 || lanes[i] > LANES_MAX || (lanes[i] & (lanes[i] - 1))) return 0;
    if (d->slice_count < 1 || d->slice_count > KERNEL_SLICES_MAX) return 0;
    for (int i = 0; i < d->slice_count; i++) {
        if (d->slice_width[i] < 1 || d->slice_width[i] > WIDTH_MAX) return 0;
        features += d->slice_width[i];
    }
    return features <= WIDTH_MAX && d->offset_count >= 1 && d->offset_count <= OFFSETS_MAX && d->plane_channels >= 0 &&
           d->plane_channels <= CHANNELS_MAX && d->plane_size >= (d->plane_channels ? 2 : 0) &&
           d->plane_size <= PLANE_SIZE_MAX && d->frequency_count >= 0 && d->frequency_count <= FREQUENCIES_MAX &&
           d->plane_shift >= 0 && d->plane_shift <= PLANE_SHIFT_MAX && d->hyper_layers >= 1 &&
           d->hyper_layers <= LAYERS_MAX && d->sarm_layers <= LAYERS_MAX &&
           d->sarm_layers >= (d->plane_channels ? 1 : 0) && d->carm_layers >= 1 && d->carm_layers <= LAYERS_MAX &&
           d->cell_shift >= -1 && d->cell_shift <= CELL_INDEX &&
           (d->frame != NULL || d->plane_channels + d->frequency_count == 0 || d->planes == NULL);
}

/* Takes the next layer of a description from the running pointers. Returns whether its numbers are allowed. */
static int next_layer(kernel_description *d, int32_t in, int32_t out, plain_layer *to)
{
    to->out = d->shape[0];
    to->in = d->shape[1];
    if (to->in != in || to->out < 1 || to->out > 4 * WIDTH_MAX || (out ? to->out != out : to->out > WIDTH_MAX))
        return 0;
    to->weight = d->weight;
    to->bias = d->bias;
    to->exponent = d->exponent;
    for (int32_t o = 0; o < to->out; o++)
        if (to->exponent[o] > EXPONENT_MAX) return 0;
    d->shape += 2;
    d->weight += (int64_t)to->out * to->in;
    d->bias += to->out;
    d->exponent += to->out;
    return 1;
}

static int next_network(arena *a, tiling by, kernel_description *d, int32_t layers, int32_t in, int32_t out,
                        network *to)
{
    plain_layer plain;
    to->count = layers;
    for (int32_t i = 0; i < layers; i++, in = plain.out) {
        if (!next_layer(d, in, i + 1 < layers ? 0 : out, &plain)) return 0;
        to->layers[i] = pack(a, by, &plain, NULL, plain.out);
    }
    return 1;
}

/* The rows of F_h's output layer that a stage needs. Returns how many they are. */
static int32_t stage_rows(const stage *g, int32_t first, int32_t total, int32_t *rows)
{
    int32_t count = 0;
    /* SPEC 7.7: the means of all channels, then all scale indices, then three step indices. */
    for (int32_t i = 0; i < g->width; i++) rows[count++] = first + i;
    for (int32_t i = 0; i < g->width; i++) rows[count++] = total + first + i;
    if (g->kind == SCALING_STAGE)
        for (int32_t i = 0; i < KINDS; i++) rows[count++] = 2 * total + i;
    return count;
}

/* SPEC 7.3, JOIN_QUADRANTS: the planes with their channels side by side. */
static void join_planes(kernel_scene *s, const int16_t *planes)
{
    int64_t size = s->plane_size, channels = s->channels, area = size * size;
    for (int64_t c = 0; c < channels; c++)
        for (int64_t i = 0; i < size; i++)
            for (int64_t j = 0; j < size; j++) {
                const int16_t *from = planes + c * area + i * size + j;
                s->joined[0][(i * size + j) * channels + c] = *from;
                for (int64_t q = 0; q < 4; q++)
                    s->joined[1][((i + (q >> 1) * size) * 2 * size + j + (q & 1) * size) * channels + c] =
                        from[(q + 1) * channels * area];
            }
}

/* SPEC 6.7: whether the numbers of a frame are allowed, so that those of contexts do not overflow. */
static int frame_allowed(const int64_t *frame)
{
    const int64_t *translation = frame + 9, *shift = frame + 12, *low = frame + 15, *high = frame + 18;
    int right = 1;
    for (int i = 0; i < 9; i++) right &= frame[i] > -MATRIX_BOUND && frame[i] < MATRIX_BOUND;
    for (int i = 0; i < 3; i++)
        right &= translation[i] > -TRANSLATION_BOUND && translation[i] < TRANSLATION_BOUND && shift[i] >= 0 &&
                 shift[i] <= FRAME_SHIFT_MAX && low[i] >= -FRAME_RANGE_BOUND && low[i] < high[i] &&
                 high[i] <= FRAME_RANGE_BOUND;
    return right;
}

/* Lays the scene out, and fills it if the arena has a base. Returns whether the description is allowed. */
static int lay_out_scene(arena *a, kernel_description d, kernel_scene *s)
{
    int32_t width[KERNEL_SLICES_MAX], hidden = d.hyper_layers - 1, rows[4 * WIDTH_MAX];
    const tiling by = s->variant->by;
    memcpy(width, d.slice_width, sizeof width);
    s->features = 0;
    for (int32_t i = 0; i < d.slice_count; i++) s->features += width[i];
    s->offset_count = d.offset_count;
    s->channels = d.plane_channels;
    s->plane_size = d.plane_size;
    s->frequencies = d.frequency_count;
    s->plane_shift = d.plane_shift;
    s->plane_lanes = d.plane_lanes;
    s->mask_lanes = d.mask_lanes;
    s->attribute_lanes = d.attribute_lanes;
    s->cell_shift = d.cell_shift;
    s->width = s->features + SCALINGS + 3 * d.offset_count;
    s->inputs = 2 * d.plane_channels + 2 * d.frequency_count;
    s->has_frame = d.frame != NULL;
    s->has_planes = d.planes != NULL;
    /* SPEC 7.7: F_h. */
    plain_layer last = {s->inputs, s->inputs, NULL, NULL, NULL};
    s->hidden.count = hidden;
    for (int32_t i = 0; i < hidden; i++) {
        if (!next_layer(&d, last.out, 0, &last)) return 0;
        s->hidden.layers[i] = pack(a, by, &last, NULL, last.out);
    }
    if (!next_layer(&d, last.out, 2 * s->width + KINDS, &last)) return 0;
    if (d.plane_channels && !next_network(a, by, &d, d.sarm_layers, 4, 2, &s->sarm)) return 0;
    /* SPEC 7.10: the order of the stages. */
    s->stage_count = 2 + d.slice_count;
    for (int32_t i = 0, channel = 0; i < s->stage_count; i++) {
        stage *g = &s->stages[i];
        g->kind = i < 2 ? i : FEATURE_STAGE;
        g->first = channel;
        g->width = i == 0 ? SCALINGS : i == 1 ? 3 * d.offset_count : width[i - 2];
        int32_t first = i == 0 ? s->features : i == 1 ? s->features + SCALINGS : channel;
        int32_t count = stage_rows(g, first, s->width, rows);
        g->hyper = pack(a, by, &last, rows, count);
        g->carm.count = 0;
        if (i < 2) continue;
        /* SPEC 7.9: CARM. */
        if (i > 2 && !next_network(a, by, &d, d.carm_layers, channel, 2 * g->width, &g->carm)) return 0;
        channel += g->width;
    }
    uint64_t points = (uint64_t)s->plane_size * (uint64_t)s->plane_size * (uint64_t)s->channels;
    s->joined[0] = take(a, d.planes ? points : 0, 2);
    s->joined[1] = take(a, d.planes ? 4 * points : 0, 2);
    /* SPEC 7.6 and 7.12: the models of masks and of positions. */
    uint32_t contexts = (uint32_t)(d.offset_count * (d.offset_count + 1) / 2);
    s->kept = take(a, contexts, 2);
    take_models(a, &s->cells, POSITION_MODELS);
    if (!a->base) return 1;
    memcpy(s->carm_shift, d.carm_shift, (size_t)(s->features - width[d.slice_count - 1]));
    for (int32_t i = 0; i < s->features - width[d.slice_count - 1]; i++)
        if (s->carm_shift[i] > CARM_SHIFT_MAX) return 0;
    if (d.frame) {
        if (!frame_allowed(d.frame)) return 0;
        memcpy(s->matrix, d.frame, sizeof s->matrix);
        memcpy(s->translation, d.frame + 9, sizeof s->translation);
        memcpy(s->shift, d.frame + 12, sizeof s->shift);
        for (int axis = 0; axis < 3; axis++) {
            s->low[axis] = (int32_t)d.frame[15 + axis];
            s->high[axis] = (int32_t)d.frame[18 + axis];
        }
    }
    if (d.planes) join_planes(s, d.planes);
    if (d.mask_model)
        for (uint32_t i = 0; i < contexts; i++) {
            s->kept[i] = d.mask_model[i];
            if (s->kept[i] < 1 || s->kept[i] >= TOTAL) return 0;
        }
    if (d.position_model)
        for (uint32_t i = 0; i < POSITION_MODELS; i++)
            if (!add_model(&s->cells, i, d.position_model + HALVES * i, HALVES, 0, 0)) return 0;
    return 1;
}

KERNEL_API kernel_scene *kernel_scene_new(const kernel_description *description, const kernel_tables *tables,
                                          int32_t variant)
{
    kernel_scene counted;
    arena a = {NULL, 0};
    if (!kernel_variant_runs(variant) || !allowed(description)) return NULL;
    memset(&counted, 0, sizeof counted);
    counted.variant = variants[variant];
    take(&a, 1, sizeof counted);
    if (!lay_out_scene(&a, *description, &counted)) return NULL;
    uint8_t *block = calloc(1, (size_t)a.used + 64);
    if (!block) return NULL;
    a.base = (uint8_t *)(((uintptr_t)block + 63) / 64 * 64);
    a.used = 0;
    kernel_scene *s = take(&a, 1, sizeof *s);
    s->tables = tables;
    s->variant = variants[variant];
    s->block = block;
    if (lay_out_scene(&a, *description, s)) return s;
    free(block);
    return NULL;
}

KERNEL_API void kernel_scene_free(kernel_scene *scene)
{
    if (scene) free(scene->block);
}

KERNEL_API void kernel_free(void *memory) { free(memory); }

/* ------------------------------------------------------------------------------------------------------ threads -- */

/* Work that threads draw from one counter. run: does item i. */
typedef struct job {
    int64_t count, next;
    void (*run)(const struct job *, int64_t, workspace *);
    const kernel_scene *scene;
    kernel_chunk *chunks;
    const uint8_t *const *from;
    uint8_t **to;
    const uint64_t *from_length;
    uint64_t *to_length;
    int16_t *planes;
    const int16_t *given;
    kernel_verdict *verdict;
    const splat_job *splat;
} job;

static void *work(void *argument)
{
    job *j = argument;
    workspace w = {NULL, NULL, 0};
    for (;;) {
        int64_t i = __atomic_fetch_add(&j->next, 1, __ATOMIC_RELAXED);
        if (i >= j->count) break;
        j->run(j, i, &w);
    }
    free(w.block);
    return NULL;
}

static void run_job(job *j, int32_t threads)
{
#if KERNEL_THREADS
    enum { THREADS_MAX = 256 };
    pthread_t helpers[THREADS_MAX];
    int64_t most = threads < j->count ? threads : j->count, started = 0;
    if (most > THREADS_MAX) most = THREADS_MAX;
    /* What no thread could be started for is done by the others. */
    while (started + 1 < most && !pthread_create(&helpers[started], NULL, work, j)) started++;
    work(j);
    while (started > 0) pthread_join(helpers[--started], NULL);
#else
    (void)threads;
    work(j);
#endif
}

static void run_decode_plane(const job *j, int64_t i, workspace *w)
{
    const kernel_scene *s = j->scene;
    int64_t points = (int64_t)s->channels * s->plane_size * s->plane_size;
    kernel_verdict *v = &j->verdict[i];
    v->status = s->variant->decode_plane(s, j->from[i], j->from_length[i], j->planes + i * points, w, v);
}

KERNEL_API void kernel_decode_planes(const kernel_scene *scene, const uint8_t *const *part, const uint64_t *length,
                                     int16_t *planes, kernel_verdict *verdict, int32_t threads)
{
    job j = {.count = PLANES, .run = run_decode_plane, .scene = scene, .from = part, .from_length = length,
             .planes = planes, .verdict = verdict};
    run_job(&j, threads);
}

static void run_encode_plane(const job *j, int64_t i, workspace *w)
{
    const kernel_scene *s = j->scene;
    int64_t points = (int64_t)s->channels * s->plane_size * s->plane_size;
    j->verdict[i].status = s->variant->encode_plane(s, j->given + i * points, &j->to[i], &j->to_length[i], w);
}

KERNEL_API void kernel_encode_planes(const kernel_scene *scene, const int16_t *planes, uint8_t **part,
                                     uint64_t *length, kernel_verdict *verdict, int32_t threads)
{
    job j = {.count = PLANES, .run = run_encode_plane, .scene = scene, .given = planes, .to = part,
             .to_length = length, .verdict = verdict};
    for (int i = 0; i < PLANES; i++) part[i] = NULL;
    run_job(&j, threads);
}

static void run_decode_chunk(const job *j, int64_t i, workspace *w)
{
    kernel_chunk *c = &j->chunks[i];
    c->verdict.status = j->scene->variant->decode_chunk(j->scene, c, w);
}

KERNEL_API void kernel_decode_chunks(const kernel_scene *scene, kernel_chunk *chunks, int64_t count, int32_t threads)
{
    job j = {.count = count, .run = run_decode_chunk, .scene = scene, .chunks = chunks};
    run_job(&j, threads);
}

static void run_encode_chunk(const job *j, int64_t i, workspace *w)
{
    kernel_chunk *c = &j->chunks[i];
    c->verdict.status = j->scene->variant->encode_chunk(j->scene, c, w);
}

KERNEL_API void kernel_encode_chunks(const kernel_scene *scene, kernel_chunk *chunks, int64_t count, int32_t threads)
{
    job j = {.count = count, .run = run_encode_chunk, .scene = scene, .chunks = chunks};
    for (int64_t i = 0; i < count; i++)
        for (int part = 0; part < KERNEL_PARTS; part++) chunks[i].part[part] = NULL;
    run_job(&j, threads);
}

/* Lays the networks out, and packs them if the arena has a base. The rest is as in kernel_splatter_new. */
static void lay_out_splatter(arena *a, kernel_splatter *s, int32_t width, const int16_t *weight, const int32_t *bias,
                             const uint8_t *exponent)
{
    const int32_t outputs[NETWORKS] = {1, 7, s->colours}, place[NETWORKS] = {LOGIT, LENGTHS, HARMONICS};
    const tiling by = s->variant->by;
    plain_layer last[NETWORKS];
    int32_t first[NETWORKS], used[NETWORKS];
    s->units = 0;
    for (int n = 0; n < NETWORKS; n++) {
        plain_layer hidden = {s->features, width, weight, bias, exponent};
        weight += s->features * width;
        last[n] = (plain_layer){width, s->offsets * outputs[n], weight, bias + width, exponent + width};
        for (int32_t i = used[n] = 0; i < width * last[n].out; i++)
            if (weight[i] && used[n] < i % width + 1) used[n] = i % width + 1;
        weight += width * last[n].out;
        bias += width + last[n].out;
        exponent += width + last[n].out;
        hidden.out = used[n];
        first[n] = s->units;
        s->hidden[n] = pack(a, by, &hidden, NULL, hidden.out);
        s->units += s->hidden[n].out;
    }
    for (int32_t k = 0; k < s->offsets; k++) {
        int16_t joined[OUTPUTS_MAX * 2 * PAIRS_MAX] = {0};
        int32_t biases[OUTPUTS_MAX] = {0};
        uint8_t exponents[OUTPUTS_MAX] = {0};
        for (int n = 0; n < NETWORKS; n++)
            for (int32_t o = 0; o < outputs[n]; o++) {
                int32_t to = place[n] + o, from = k * outputs[n] + o;
                memcpy(joined + to * s->units + first[n], last[n].weight + from * width, 2 * (size_t)used[n]);
                biases[to] = last[n].bias[from];
                exponents[to] = last[n].exponent[from];
            }
        plain_layer own = {s->units, HARMONICS + s->colours, joined, biases, exponents};
        s->last[k] = pack(a, by, &own, NULL, own.out);
    }
}

EXPORT("makeSplatter")
kernel_splatter *kernel_splatter_new(int32_t variant, uint32_t features, uint32_t width, uint32_t offsets,
                                     uint32_t colours, const int16_t *weight, const int32_t *bias,
                                     const uint8_t *exponent)
{
    if (features < 1 || features > WIDTH_MAX || width < 1 || width > WIDTH_MAX || !kernel_variant_runs(variant))
        return NULL;
    if (offsets < 1 || offsets > OFFSETS_MAX || colours < 1 || colours > HARMONICS_MAX) return NULL;
    kernel_splatter counted = {.variant = variants[variant], .features = (int32_t)features,
                               .offsets = (int32_t)offsets, .colours = (int32_t)colours};
    arena a = {NULL, 0};
    take(&a, 1, sizeof counted);
    lay_out_splatter(&a, &counted, (int32_t)width, weight, bias, exponent);
    a = (arena){calloc(1, (size_t)a.used), 0};
    kernel_splatter *s = take(&a, 1, sizeof counted);
    if (!s) return NULL;
    *s = counted;
    lay_out_splatter(&a, s, (int32_t)width, weight, bias, exponent);
    return s;
}

static void run_splat(const job *j, int64_t i, workspace *w)
{
    if (!j->splat->networks->variant->splat(j->splat, i, w)) j->splat->place[i] = -1;
}

EXPORT("splat")
int32_t kernel_splat(const kernel_splatter *s, uint32_t count, const float *position, const uint8_t *mask,
                     const void *feature, const void *scaling, const void *offset, const uint8_t *steps,
                     const float *step, uint32_t room, uint32_t stride, float *mean, float *length, float *quaternion,
                     float *logit, float *harmonic, int32_t threads)
{
    const int64_t pieces = ((int64_t)count + PIECE - 1) / PIECE, offsets = s->offsets;
    int64_t kept = 0, *place = malloc(sizeof *place * (size_t)(pieces + 1));
    if (!place) return KERNEL_NO_MEMORY;
    for (int64_t i = 0; i < count * offsets; i++) {
        if (i % (PIECE * offsets) == 0) place[i / (PIECE * offsets)] = kept;
        kept += mask[i] != 0;
    }
    splat_job own = {s, count, place, mask, steps, position, step, feature, scaling, offset,
                     {mean, length, quaternion, logit, harmonic}, {3, 3, 4, 1, (uint32_t)s->colours}};
    for (int c = 0; c < COLUMNS && stride; c++) own.stride[c] = stride;
    job j = {.count = kept > room ? 0 : pieces, .run = run_splat, .splat = &own};
    run_job(&j, threads);
    for (int64_t i = 0; i < j.count; i++)
        if (place[i] < 0) kept = KERNEL_NO_MEMORY;
    free(place);
    return kept > room ? KERNEL_REFUSED : (int32_t)kept;
}

KERNEL_API void kernel_decode_weights(const kernel_tables *tables, int32_t variant, const uint8_t *part,
                                      uint64_t length, int32_t lanes, const uint8_t *scale, uint64_t few,
                                      uint64_t many, int32_t *symbols, kernel_verdict *verdict)
{
    const uint64_t counts[2] = {few, many};
    decoder d;
    verdict->status = KERNEL_REFUSED;
    if (!kernel_variant_runs(variant) || lanes < 1 || lanes > LANES_MAX || (lanes & (lanes - 1))) return;
    verdict->status = KERNEL_NO_MEMORY;
    if (length > SIZE_MAX - 2 * WORDS_PAST) return;
    uint16_t *words = malloc((size_t)length + 2 * WORDS_PAST);
    if (!words) return;
    verdict->status = open_decoder(&d, part, length, lanes, words);
    if (!verdict->status) verdict->status = variants[variant]->decode_weights(tables, &d, scale, counts, symbols);
    if (!verdict->status) verdict->status = close_decoder(&d, verdict);
    free(words);
}

KERNEL_API void kernel_values(int32_t variant, const int32_t *symbols, const uint8_t *index, int64_t stride,
                              const float *step, int64_t rows, int64_t width, float *values)
{
    variants[kernel_variant_runs(variant) ? variant : 0]->values(symbols, index, stride, step, rows, width, values);
}
