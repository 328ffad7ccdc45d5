/* A decoder for C3GS, format version 0, written from SPEC.md alone.
 *
 *   decoder digest FILE           prints the digests of the canonical reconstruction (9.3)
 *   decoder decode FILE OUTPUT    writes the canonical reconstruction
 *
 * The exit status is:
 *
 *   0   done
 *   1   the file is malformed or invalid
 *   2   the file is unsupported
 *   3   wrong usage, or a failure of input, output or memory
 *
 * With status 1 or 2 the last line on stderr is {"code":C, "offset":O}. The tables of Annex A are read from the file
 * that the environment variable C3GS_TABLES names, or else from tables-0.bin in the folder of the program.
 *
 * The comment above a function begins with its clauses of SPEC.md. Names are those of SPEC.md where it has one.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---------------------------------------------------------------- 2.5 constants */

enum {
    HEADER_LENGTH_MIN = 4,
    HEADER_LENGTH_MAX = 65535,
    LANES_LOG2_MAX = 8,
    LANES_MAX = 1 << LANES_LOG2_MAX,
    SCALE_EXPONENT_MAX = 60,
    MATRIX_BOUND = 1 << 20,
    FRAME_SHIFT_MAX = 60,
    FRAME_RANGE_BOUND = 1 << 18,
    PLANE_SHIFT_MAX = 10,
    CARM_SHIFT_MAX = 16,
    WEIGHT_SYMBOL_MAX = (1 << 24) - 1,
    WEIGHT_EXPONENT_MIN = -104,
    WEIGHT_EXPONENT_MAX = 149,
    PLANE_SYMBOL_MAX = (1 << 15) - 1,
    ATTRIBUTE_SYMBOL_MAX = (1 << 23) - 1,
    CELL_LEVELS = 16,
    CELL_INDEX = 40,
    POSITION_MODELS = 18,
    ACTIVATION_MAX = 1023,
    WEIGHT_MAX = 1023,
    ACCUMULATOR_BOUND = 1 << 24,
    EXPONENT_MAX = 20,
    UNIT_BITS = 16,
    FRAME_CLAMP = (1 << 30) - 1,
    LERP_BITS = 8,
    STATE_MIN = 1 << 16,
    PRECISION = 14,
    RAW_MAX = 16,
    ESCAPE_PREFIX_MAX = 25,
    SCALE_MIN = -40,
    SCALE_END = 24,
    FRACTIONS = 16,
    SINE_LENGTH = 1024,
    STEP_LENGTH = 64,
    STEP_SHIFT = 12,
    TABLES_LENGTH = 99840,
    PROLOGUE_LENGTH = 20,
    FRAME_LENGTH = 88,
    CHUNK_ENTRY_LENGTH = 24,
    POSITION_MODEL_LENGTH = 577,
    LAYER_MODEL_LENGTH = 6
};
#define ORIGIN_BOUND (INT64_C(1) << 62)
#define TRANSLATION_BOUND (INT64_C(1) << 61)
#define BASE_STEP_MIN 0x1p-60f
#define BASE_STEP_MAX 0x1p60f

/* ---------------------------------------------------------------- 10.2 registry */

enum error {
    PROLOGUE_TRUNCATED = 101, PROLOGUE_SIGNATURE, PROLOGUE_CRC, PROLOGUE_VERSION, PROLOGUE_HEADER_LENGTH,
    HEADER_TRUNCATED = 201, HEADER_CRC, HEADER_SYNTAX, HEADER_RESERVED, HEADER_PROFILE, HEADER_LEVEL, HEADER_DIMENSION,
    HEADER_ANCHOR_COUNT, HEADER_LEVEL_NOT_MINIMAL, HEADER_CHUNK_SIZE, HEADER_LANES, HEADER_BASE_STEP, HEADER_POSITION_GRID,
    HEADER_RENDER_INFO,
    DIRECTORY_UNKNOWN_CRITICAL = 301, DIRECTORY_ORDER, DIRECTORY_MODE, DIRECTORY_OFFSET, DIRECTORY_LENGTH,
    DIRECTORY_FILE_LENGTH, SECTION_CRC,
    FRAME_RANGE = 401,
    WEIGHTS_SCALE = 411, WEIGHTS_NOT_FINITE, WEIGHTS_BOUND, WEIGHTS_LENGTH, WEIGHTS_LAYER, WEIGHTS_EXPONENT, WEIGHTS_RAW,
    PLANES_LENGTH = 421,
    CHUNKS_MASK_MODEL = 431, CHUNKS_LENGTH, CHUNKS_CRC, CHUNKS_POSITION_MODEL,
    POSITIONS_NOT_FINITE = 441, POSITIONS_NEGATIVE_ZERO, POSITIONS_FORM, POSITIONS_RAW, POSITIONS_COUNT, POSITIONS_CELL,
    SUBSTREAM_LENGTH = 501, SUBSTREAM_STATE, SUBSTREAM_WORDS, SUBSTREAM_FINAL_STATE, SUBSTREAM_ESCAPE,
    SUBSTREAM_SYMBOL_RANGE, SUBSTREAM_RAW_LENGTH, SUBSTREAM_RAW_PADDING, SUBSTREAM_SYMBOL_CRC
};

enum { STATUS_REFUSED = 1, STATUS_UNSUPPORTED = 2, STATUS_FAILED = 3 };

/* All allocated memory is in one list, so that every exit can release it. */
struct block {
    struct block *next;
    uint64_t length; /* it also keeps what follows aligned to 16 bytes */
};
static struct block *blocks;

/* not of the specification */
static void RELEASE(void)
{
    while (blocks) {
        struct block *next = blocks->next;
        free(blocks);
        blocks = next;
    }
}

/* not of the specification: ends the program for wrong usage, or for a failure of input, output or memory */
_Noreturn static void FAIL(const char *message)
{
    fprintf(stderr, "decoder: %s\n", message);
    RELEASE();
    exit(STATUS_FAILED);
}

/* 10.1, 10.2: the first error ends the decoding */
_Noreturn static void REFUSE(enum error code, uint64_t offset)
{
    int unsupported = code == PROLOGUE_VERSION || code == HEADER_PROFILE || code == HEADER_LEVEL ||
                      code == DIRECTORY_UNKNOWN_CRITICAL || code == DIRECTORY_MODE;
    fprintf(stderr, "{\"code\":%d, \"offset\":%llu}\n", (int)code, (unsigned long long)offset);
    RELEASE();
    exit(unsupported ? STATUS_UNSUPPORTED : STATUS_REFUSED);
}

/* 13.1: callers have checked the count against the file or the level */
static void *ALLOCATE(uint64_t count, uint64_t size)
{
    uint64_t bytes = count * size; /* count < 2^32, size < 2^16 */
    struct block *b;
    if (bytes > SIZE_MAX - sizeof *b)
        FAIL("out of memory");
    b = calloc(1, sizeof *b + (size_t)bytes);
    if (!b)
        FAIL("out of memory");
    b->next = blocks;
    b->length = bytes;
    blocks = b;
    return b + 1;
}

/* ---------------------------------------------------------------- 2.2 to 2.4 numbers */

/* 2.3 */
static uint32_t GET_U16(const uint8_t *p) { return (uint32_t)p[0] | (uint32_t)p[1] << 8; }
static uint32_t GET_U32(const uint8_t *p) { return GET_U16(p) | GET_U16(p + 2) << 16; }
static uint64_t GET_U64(const uint8_t *p) { return GET_U32(p) | (uint64_t)GET_U32(p + 4) << 32; }

/* 2.3 */
static int64_t GET_I16(const uint8_t *p)
{
    int64_t v = GET_U16(p);
    return v < 0x8000 ? v : v - 0x10000;
}

/* 2.3 */
static int64_t GET_I32(const uint8_t *p)
{
    int64_t v = GET_U32(p);
    return v < INT64_C(0x80000000) ? v : v - INT64_C(0x100000000);
}

/* 2.3 */
static int64_t GET_I64(const uint8_t *p)
{
    uint64_t v = GET_U64(p);
    return v >> 63 ? -(int64_t)(~v) - 1 : (int64_t)v;
}

/* 9.3: little-endian, as 2.3 */
static void PUT_U16(uint8_t *p, uint32_t v)
{
    p[0] = (uint8_t)v;
    p[1] = (uint8_t)(v >> 8);
}

/* 9.3 */
static void PUT_U32(uint8_t *p, uint32_t v)
{
    PUT_U16(p, v & 0xFFFF);
    PUT_U16(p + 2, v >> 16);
}

/* 2.3 */
static float F32(uint32_t bits)
{
    float x;
    memcpy(&x, &bits, 4);
    return x;
}

/* 2.3 */
static int FINITE(uint32_t bits) { return (bits >> 23 & 255) != 255; }

/* 2.3: a finite f32 is m * 2^e, with m below 2^24 in magnitude */
static void SPLIT_F32(uint32_t bits, int64_t *m, int *e)
{
    int exponent = (int)(bits >> 23 & 255);
    *m = (int64_t)(bits & 0x7FFFFF) | (exponent ? 0x800000 : 0);
    *e = exponent ? exponent - 150 : -149;
    if (bits >> 31)
        *m = -*m;
}

/* 2.4: a >> s, rounded towards minus infinity, for s <= 62. It never shifts a negative number. */
static int64_t RSHIFT(int64_t a, unsigned s) { return a >= 0 ? a >> s : ~(~a >> s); }

/* 2.4: for s <= 62. At every use a is below 2^63 in magnitude, with the rounding term too. */
static int64_t RSHIFT_ROUND(int64_t a, unsigned s) { return RSHIFT(a + ((INT64_C(1) << s) >> 1), s); }

/* 2.4: a // b, for b > 0 */
static int64_t FLOOR_DIV(int64_t a, int64_t b) { return a / b - (a % b < 0); }

/* 2.4 */
static int64_t CLAMP(int64_t a, int64_t low, int64_t high) { return a < low ? low : a > high ? high : a; }
/* 6: |a|, for any a but -2^63 */
static int64_t MAGNITUDE(int64_t a) { return a < 0 ? -a : a; }

/* 2.4: for 0 <= a < 2^62 */
static int64_t ISQRT(int64_t a)
{
    uint64_t rest = (uint64_t)a, root = 0, bit = UINT64_C(1) << 60;
    for (; bit; bit >>= 2) {
        if (rest >= root + bit) {
            rest -= root + bit;
            root = (root >> 1) + bit;
        } else {
            root >>= 1;
        }
    }
    return (int64_t)root;
}

/* 2.4: a result of 2^53 or more in magnitude may be inexact, because no bound of 7.2 allows it */
static int64_t ROUND_SCALED(uint32_t x, int e)
{
    int64_t m;
    int shift;
    SPLIT_F32(x, &m, &shift);
    shift += e;
    if (shift >= 0)
        return m * (INT64_C(1) << (shift > 30 ? 30 : shift));
    return shift < -40 ? 0 : RSHIFT_ROUND(m, (unsigned)-shift);
}

/* 2.4: the bits of the f32, for |n| < 2^63. The result is normal or zero. */
static uint32_t ROUND_F32(int64_t n, int e)
{
    uint64_t a = n < 0 ? (uint64_t)-n : (uint64_t)n, m = a;
    int s = 0;
    if (!a)
        return 0;
    while (a >> s >> 24)
        s++;
    if (s) {
        m = (a + (UINT64_C(1) << (s - 1))) >> s;
        if ((a & ((UINT64_C(1) << s) - 1)) == UINT64_C(1) << (s - 1))
            m &= ~UINT64_C(1);
    }
    e += s;
    for (; m < UINT64_C(1) << 23; m <<= 1)
        e--;
    for (; m >= UINT64_C(1) << 24; m >>= 1) /* only 2^24, after a carry */
        e++;
    return (n < 0 ? UINT32_C(1) << 31 : 0) | (uint32_t)(e + 150) << 23 | ((uint32_t)m & 0x7FFFFF);
}

/* ---------------------------------------------------------------- 2.3 CRC-32; SHA-256 (FIPS 180-4) */

static uint32_t crc_table[256];

/* 2.3 */
static void MAKE_CRC_TABLE(void)
{
    for (uint32_t n = 0; n < 256; n++) {
        uint32_t c = n;
        for (int k = 0; k < 8; k++)
            c = c & 1 ? 0xEDB88320 ^ c >> 1 : c >> 1;
        crc_table[n] = c;
    }
}

/* 2.3: crc is 0, or the CRC-32 of the bytes before */
static uint32_t CRC32(uint32_t crc, const uint8_t *p, uint64_t n)
{
    crc = ~crc;
    for (uint64_t i = 0; i < n; i++)
        crc = crc_table[(crc ^ p[i]) & 255] ^ crc >> 8;
    return ~crc;
}

struct sha256 {
    uint32_t h[8];
    uint64_t length;
    uint8_t block[64];
};

static const uint32_t SHA_K[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5, 0xd807aa98, 0x12835b01, 0x243185be,
    0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174, 0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa,
    0x5cb0a9dc, 0x76f988da, 0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967, 0x27b70a85,
    0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85, 0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3,
    0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070, 0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f,
    0x682e6ff3, 0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};

/* 9.3 */
static uint32_t ROTR(uint32_t x, int n) { return x >> n | x << (32 - n); }

/* 9.3 */
static void SHA_START(struct sha256 *s)
{
    static const uint32_t h[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    memcpy(s->h, h, sizeof h);
    s->length = 0;
}

/* 9.3 */
static void SHA_BLOCK(struct sha256 *s)
{
    uint32_t w[64], v[8];
    for (int i = 0; i < 16; i++)
        w[i] = (uint32_t)s->block[4 * i] << 24 | (uint32_t)s->block[4 * i + 1] << 16 | (uint32_t)s->block[4 * i + 2] << 8 | s->block[4 * i + 3];
    for (int i = 16; i < 64; i++)
        w[i] = w[i - 16] + (ROTR(w[i - 15], 7) ^ ROTR(w[i - 15], 18) ^ w[i - 15] >> 3) + w[i - 7] +
               (ROTR(w[i - 2], 17) ^ ROTR(w[i - 2], 19) ^ w[i - 2] >> 10);
    memcpy(v, s->h, sizeof v);
    for (int i = 0; i < 64; i++) {
        uint32_t t = v[7] + (ROTR(v[4], 6) ^ ROTR(v[4], 11) ^ ROTR(v[4], 25)) + ((v[4] & v[5]) ^ (~v[4] & v[6])) + SHA_K[i] + w[i];
        uint32_t u = (ROTR(v[0], 2) ^ ROTR(v[0], 13) ^ ROTR(v[0], 22)) + ((v[0] & v[1]) ^ (v[0] & v[2]) ^ (v[1] & v[2]));
        memmove(v + 1, v, 7 * sizeof *v);
        v[4] += t;
        v[0] = t + u;
    }
    for (int i = 0; i < 8; i++)
        s->h[i] += v[i];
}

/* 9.3 */
static void SHA_ADD(struct sha256 *s, const uint8_t *p, uint64_t n)
{
    for (uint64_t i = 0; i < n; i++) {
        s->block[s->length++ % 64] = p[i];
        if (s->length % 64 == 0)
            SHA_BLOCK(s);
    }
}

/* 9.3 */
static void SHA_END(struct sha256 *s, char hex[65])
{
    static const uint8_t pad[64] = {0x80};
    uint64_t bits = 8 * s->length;
    uint8_t tail[8];
    SHA_ADD(s, pad, 1 + (119 - s->length % 64) % 64);
    for (int i = 0; i < 8; i++)
        tail[i] = (uint8_t)(bits >> (56 - 8 * i));
    SHA_ADD(s, tail, 8);
    for (int i = 0; i < 8; i++)
        snprintf(hex + 8 * i, 9, "%08lx", (unsigned long)s->h[i]);
}

/* ---------------------------------------------------------------- Annex A tables */

struct model { /* 8.4 */
    int radius;
    uint16_t frequency[2 * 255 + 2];
};
typedef struct model family[SCALE_END - SCALE_MIN][FRACTIONS];

static int64_t SINE[SINE_LENGTH];
static int64_t STEP[STEP_LENGTH];
static family GAUSS, LAPLACE;

/* A */
static void READ_TABLES(const uint8_t *data, uint64_t length)
{
    struct sha256 s;
    char hex[65];
    SHA_START(&s);
    SHA_ADD(&s, data, length);
    SHA_END(&s, hex);
    if (length != TABLES_LENGTH || strcmp(hex, "b8b489ae1faadaa4b3c91467cd7517a68c3ac7cda6ee1c5a2c8282dd3ec087b5"))
        FAIL("the table file is not that of Annex A");
    for (int j = 0; j < SINE_LENGTH; j++)
        SINE[j] = GET_I16(data + 2 * j);
    for (int q = 0; q < STEP_LENGTH; q++)
        STEP[q] = GET_U16(data + 2 * SINE_LENGTH + 2 * q);
    data += 2 * SINE_LENGTH + 2 * STEP_LENGTH;
    for (int f = 0; f < 2; f++)
        for (int row = 0; row < SCALE_END - SCALE_MIN; row++)
            for (int column = 0; column < FRACTIONS; column++) {
                struct model *m = f ? &LAPLACE[row][column] : &GAUSS[row][column];
                m->radius = data[0];
                for (int j = 0; j < 2 * m->radius + 2; j++)
                    m->frequency[j] = (uint16_t)GET_U16(data + 1 + 2 * j);
                data += 1 + 2 * (2 * m->radius + 2);
            }
}

/* ---------------------------------------------------------------- 5.2 to 5.6 the header */

struct list { /* 5.3: a length and that many items of type u8, with the offsets of both */
    uint32_t at, items_at;
    uint8_t count, item[255];
};

struct entry {
    uint32_t at; /* the offset of type. mode is at + 1, reserved at + 2, offset at + 4, length at + 8. */
    uint8_t type, mode;
    uint32_t reserved, offset, length, crc;
};

struct header {
    uint32_t length, end; /* end is the first byte after the header */
    uint8_t profile, level, section_count, reserved_0, reserved_1;
    uint32_t anchor_count, chunk_size;
    uint8_t lanes_log2[3]; /* of planes, masks, attributes */
    uint8_t offset_count, plane_channels, frequency_count, render_width;
    uint32_t plane_size;
    struct list slice_width, hyper_width, sarm_width, carm_width;
    uint32_t offset_count_at, plane_channels_at, frequency_count_at, plane_size_at, render_width_at;
    uint32_t base_step_at, base_step[3];
    uint32_t grid_at;
    int64_t origin[3];
    uint32_t scale_mantissa;
    int scale_exponent;
    uint8_t grid_reserved;
    uint32_t render_at;
    struct entry directory[255];
    /* derived: F, D (6.3) and C (6.10) */
    uint32_t features, channels, chunks;
};

struct cursor {
    const uint8_t *data;
    uint64_t at, end; /* end is where header_crc starts */
};

/* 5: the next n bytes of the header */
static const uint8_t *TAKE(struct cursor *c, uint64_t n)
{
    if (n > c->end - c->at)
        REFUSE(HEADER_SYNTAX, c->end + 4); /* the end of the header, with header_crc */
    c->at += n;
    return c->data + c->at - n;
}

/* 5.3 */
static void TAKE_LIST(struct cursor *c, struct list *l)
{
    l->at = (uint32_t)c->at;
    l->count = *TAKE(c, 1);
    l->items_at = (uint32_t)c->at;
    memcpy(l->item, TAKE(c, l->count), l->count);
}

/* 6.1, and 6.2 as far as R6.2-2 */
static void PROLOGUE(struct header *h, const uint8_t *data, uint64_t length)
{
    static const uint8_t signature[8] = {0x89, 0x43, 0x33, 0x47, 0x0D, 0x0A, 0x1A, 0x0A};
    if (length < PROLOGUE_LENGTH)
        REFUSE(PROLOGUE_TRUNCATED, length);
    if (memcmp(data, signature, 8))
        REFUSE(PROLOGUE_SIGNATURE, 0);
    if (GET_U32(data + 16) != CRC32(0, data, 16))
        REFUSE(PROLOGUE_CRC, 16);
    if (GET_U32(data + 8) != 0)
        REFUSE(PROLOGUE_VERSION, 8);
    h->length = GET_U32(data + 12);
    if (h->length < HEADER_LENGTH_MIN || h->length > HEADER_LENGTH_MAX)
        REFUSE(PROLOGUE_HEADER_LENGTH, 12);
    h->end = PROLOGUE_LENGTH + h->length;
    if (length < h->end)
        REFUSE(HEADER_TRUNCATED, length);
    if (GET_U32(data + h->end - 4) != CRC32(0, data + PROLOGUE_LENGTH, h->length - 4))
        REFUSE(HEADER_CRC, h->end - 4);
}

/* 5.2 to 5.6: R6.2-3, R6.2-4 */
static void HEADER_FIELDS(struct header *h, const uint8_t *data)
{
    struct cursor c = {data, PROLOGUE_LENGTH, h->end - 4};
    const uint8_t *p = TAKE(&c, 16);
    h->profile = p[0];
    h->level = p[1];
    h->section_count = p[2];
    h->reserved_0 = p[3];
    h->anchor_count = GET_U32(p + 4);
    h->chunk_size = GET_U32(p + 8);
    memcpy(h->lanes_log2, p + 12, 3);
    h->reserved_1 = p[15];
    h->offset_count_at = (uint32_t)c.at;
    h->offset_count = *TAKE(&c, 1);
    TAKE_LIST(&c, &h->slice_width);
    h->plane_channels_at = (uint32_t)c.at;
    h->plane_channels = *TAKE(&c, 1);
    h->frequency_count_at = (uint32_t)c.at;
    h->frequency_count = *TAKE(&c, 1);
    h->plane_size_at = (uint32_t)c.at;
    h->plane_size = GET_U16(TAKE(&c, 2));
    TAKE_LIST(&c, &h->hyper_width);
    TAKE_LIST(&c, &h->sarm_width);
    TAKE_LIST(&c, &h->carm_width);
    h->render_width_at = (uint32_t)c.at;
    h->render_width = *TAKE(&c, 1);
    h->base_step_at = (uint32_t)c.at;
    p = TAKE(&c, 12);
    for (int a = 0; a < 3; a++)
        h->base_step[a] = GET_U32(p + 4 * a);
    h->grid_at = (uint32_t)c.at;
    p = TAKE(&c, 28);
    for (int a = 0; a < 3; a++)
        h->origin[a] = GET_I64(p + 8 * a);
    h->scale_mantissa = GET_U16(p + 24);
    h->scale_exponent = p[26] < 128 ? p[26] : p[26] - 256;
    h->grid_reserved = p[27];
    h->render_at = (uint32_t)c.at;
    TAKE(&c, 60); /* 5.5: RENDER_INFO reads it */
    for (int i = 0; i < h->section_count; i++) {
        struct entry *s = &h->directory[i];
        s->at = (uint32_t)c.at;
        p = TAKE(&c, 16);
        s->type = p[0];
        s->mode = p[1];
        s->reserved = GET_U16(p + 2);
        s->offset = GET_U32(p + 4);
        s->length = GET_U32(p + 8);
        s->crc = GET_U32(p + 12);
    }
    if (c.at != c.end)
        REFUSE(HEADER_SYNTAX, c.at); /* the first byte that no field uses. It comes before header_crc. */
    if (h->reserved_0)
        REFUSE(HEADER_RESERVED, 23);
    if (h->reserved_1)
        REFUSE(HEADER_RESERVED, 35);
    if (h->grid_reserved)
        REFUSE(HEADER_RESERVED, h->grid_at + 27);
    for (int i = 0; i < h->section_count; i++)
        if (h->directory[i].reserved)
            REFUSE(HEADER_RESERVED, h->directory[i].at + 2);
}

struct bounds {
    uint32_t low, high;
};

/* 11.1: one dimension */
static void DIMENSION(uint32_t value, struct bounds b, uint64_t at)
{
    if (value < b.low || value > b.high)
        REFUSE(HEADER_DIMENSION, at);
}

/* 11.1: the length of a list, then its items */
static void DIMENSION_LIST(const struct list *l, struct bounds count, struct bounds item)
{
    DIMENSION(l->count, count, l->at);
    for (uint32_t i = 0; i < l->count; i++)
        DIMENSION(l->item[i], item, l->items_at + i);
}

/* 11.1, 11.2: profile, level, dimensions, anchor_count, chunk_size */
static void PROFILE(struct header *h)
{
    static const struct bounds table[2][14] = {
        {{1, 10}, {1, 4}, {1, 16}, {1, 8}, {1, 10}, {2, 32}, {1, 2}, {1, 64}, {1, 2}, {1, 16}, {0, 2}, {1, 64}, {1, 64}, {1, 65536}},
        {{10, 10}, {4, 4}, {5, 20}, {8, 8}, {10, 10}, {2, 256}, {1, 1}, {16, 128}, {2, 2}, {16, 16}, {1, 1}, {16, 128}, {50, 50}, {256, 65536}}};
    static const struct { uint32_t anchor_count, plane_size; } levels[4] = {{4096, 32}, {131072, 128}, {1048576, 256}, {16777216, 256}};
    const struct bounds *b;
    uint32_t lowest;
    if (h->profile > 1)
        REFUSE(HEADER_PROFILE, 20);
    lowest = h->profile ? 1 : 0;
    if (h->level < lowest || h->level > (h->profile ? 3 : 0))
        REFUSE(HEADER_LEVEL, 21);
    b = table[h->profile];
    DIMENSION(h->offset_count, b[0], h->offset_count_at);
    DIMENSION_LIST(&h->slice_width, b[1], b[2]);
    DIMENSION(h->plane_channels, b[3], h->plane_channels_at);
    DIMENSION(h->frequency_count, b[4], h->frequency_count_at);
    DIMENSION(h->plane_size, b[5], h->plane_size_at);
    DIMENSION_LIST(&h->hyper_width, b[6], b[7]);
    DIMENSION_LIST(&h->sarm_width, b[8], b[9]);
    DIMENSION_LIST(&h->carm_width, b[10], b[11]);
    DIMENSION(h->render_width, b[12], h->render_width_at);
    if ((h->carm_width.count == 0) != (h->slice_width.count == 1))
        REFUSE(HEADER_DIMENSION, h->carm_width.at);
    if (h->profile == 1)
        for (uint32_t i = 0; i < 4; i++)
            if (h->slice_width.item[i] != 5 * (i + 1))
                REFUSE(HEADER_DIMENSION, h->slice_width.items_at);
    if (h->plane_size > levels[h->level].plane_size)
        REFUSE(HEADER_DIMENSION, h->plane_size_at);
    if (h->anchor_count > levels[h->level].anchor_count)
        REFUSE(HEADER_ANCHOR_COUNT, 24);
    for (uint32_t l = lowest; l < h->level; l++)
        if (h->anchor_count <= levels[l].anchor_count && h->plane_size <= levels[l].plane_size)
            REFUSE(HEADER_LEVEL_NOT_MINIMAL, 21);
    if (h->chunk_size < b[13].low || h->chunk_size > b[13].high)
        REFUSE(HEADER_CHUNK_SIZE, 28);
}

/* 6.5 */
static void RENDER_INFO(const uint8_t *data, uint64_t at)
{
    const uint8_t *p = data + at;
    if (p[3] > 5)
        REFUSE(HEADER_RENDER_INFO, at + 3);
    for (uint32_t i = 4; i < 20; i += 4)
        if (!FINITE(GET_U32(p + i)))
            REFUSE(HEADER_RENDER_INFO, at + i);
    /* near_plane, distance_unit */
    for (uint32_t i = 4; i < 12; i += 4)
        if (!(F32(GET_U32(p + i)) > 0))
            REFUSE(HEADER_RENDER_INFO, at + i);
    if (!(F32(GET_U32(p + 12)) > 0 && F32(GET_U32(p + 12)) <= 1))
        REFUSE(HEADER_RENDER_INFO, at + 12);
    if (!(F32(GET_U32(p + 16)) >= 0))
        REFUSE(HEADER_RENDER_INFO, at + 16);
    for (uint32_t i = 20; i < 24; i += 2)
        if (GET_U16(p + i) < 1)
            REFUSE(HEADER_RENDER_INFO, at + i);
    /* camera_focal, camera_rotation and camera_translation start at 24, 32 and 48. The error names the field. */
    for (uint32_t i = 24; i < 60; i += 4)
        if (!FINITE(GET_U32(p + i)))
            REFUSE(HEADER_RENDER_INFO, at + (i < 32 ? 24 : i < 48 ? 32 : 48));
    for (uint32_t i = 24; i < 32; i += 4)
        if (!(F32(GET_U32(p + i)) > 0))
            REFUSE(HEADER_RENDER_INFO, at + 24);
    for (uint32_t i = 32; i < 48; i += 4)
        if (F32(GET_U32(p + i)) != 0)
            return;
    REFUSE(HEADER_RENDER_INFO, at + 32);
}

/* 6.2 to 6.5, 11: the requirements on the header from R6.2-3 on, in the order of their codes */
static void HEADER(struct header *h, const uint8_t *data)
{
    HEADER_FIELDS(h, data);
    PROFILE(h);
    for (uint32_t i = 0; i < 3; i++)
        if (h->lanes_log2[i] > LANES_LOG2_MAX)
            REFUSE(HEADER_LANES, 32 + i);
    for (uint32_t a = 0; a < 3; a++) {
        float x = F32(h->base_step[a]);
        if (!FINITE(h->base_step[a]) || !(x >= BASE_STEP_MIN && x <= BASE_STEP_MAX))
            REFUSE(HEADER_BASE_STEP, h->base_step_at + 4 * a);
    }
    for (uint32_t a = 0; a < 3; a++)
        if (h->origin[a] <= -ORIGIN_BOUND || h->origin[a] >= ORIGIN_BOUND)
            REFUSE(HEADER_POSITION_GRID, h->grid_at + 8 * a);
    if (h->scale_mantissa < 1)
        REFUSE(HEADER_POSITION_GRID, h->grid_at + 24);
    if (h->scale_exponent < -SCALE_EXPONENT_MAX || h->scale_exponent > SCALE_EXPONENT_MAX)
        REFUSE(HEADER_POSITION_GRID, h->grid_at + 26);
    RENDER_INFO(data, h->render_at);
    h->features = 0;
    for (int i = 0; i < h->slice_width.count; i++)
        h->features += h->slice_width.item[i];
    h->channels = h->features + 6 + 3u * h->offset_count;
    h->chunks = (h->anchor_count + h->chunk_size - 1) / h->chunk_size; /* below 2^25 */
}

/* ---------------------------------------------------------------- 5.8, 7.2 networks */

enum { LAYERS_MAX = 3, WIDTH_MAX = 256, CARM_MAX = 3 };

struct layer {
    uint32_t inputs, outputs;
    int16_t *weight; /* row by row */
    int32_t *bias;
    uint8_t *exponent;
    const uint8_t *model; /* in mode 1 its LayerModel (5.16) */
    const uint8_t *raw;   /* in mode 1 its values, if it is raw */
};

struct network {
    uint32_t layers;
    struct layer layer[LAYERS_MAX];
};

enum { HYPER, SARM, CARM_1, OPACITY = CARM_1 + CARM_MAX, COVARIANCE, COLOUR, NETWORKS };

/* 5.8: the shape of one network */
static void SHAPE(struct network *n, uint32_t inputs, uint32_t hidden, const uint8_t *width, uint32_t outputs)
{
    n->layers = hidden + 1;
    for (uint32_t i = 0; i <= hidden; i++) {
        n->layer[i].inputs = inputs;
        n->layer[i].outputs = inputs = i < hidden ? width[i] : outputs;
    }
}

/* 5.8: the shapes of all networks. Networks that are not present have no layers. */
static void SHAPES(const struct header *h, struct network *n)
{
    uint32_t k = h->offset_count, inputs = 0;
    memset(n, 0, NETWORKS * sizeof *n);
    SHAPE(&n[HYPER], 2u * h->plane_channels + 2u * h->frequency_count, h->hyper_width.count, h->hyper_width.item, 2 * h->channels + 3);
    SHAPE(&n[SARM], 4, h->sarm_width.count, h->sarm_width.item, 2);
    for (uint32_t i = 1; i < h->slice_width.count; i++) {
        inputs += h->slice_width.item[i - 1];
        SHAPE(&n[CARM_1 + i - 1], inputs, h->carm_width.count, h->carm_width.item, 2u * h->slice_width.item[i]);
    }
    SHAPE(&n[OPACITY], h->features + 4, 1, &h->render_width, k);
    SHAPE(&n[COVARIANCE], h->features + 4, 1, &h->render_width, 7 * k);
    SHAPE(&n[COLOUR], h->features + 4, 1, &h->render_width, 3 * k);
}

/* 6.6: W, which is below 2^20, because widths are below 2^8 */
static uint64_t VALUE_COUNT(const struct network *n)
{
    uint64_t count = 0;
    for (int i = 0; i < NETWORKS; i++)
        for (uint32_t l = 0; l < n[i].layers; l++)
            count += (uint64_t)n[i].layer[l].outputs * (n[i].layer[l].inputs + 1);
    return count;
}

/* 7.2: derives one row. The result is 0 if no exponent will do. */
static int DERIVE_ROW(const uint8_t *weights, uint32_t bias, struct layer *l, uint32_t row)
{
    for (int e = EXPONENT_MAX; e >= 0; e--) {
        int64_t sum = 0, b = ROUND_SCALED(bias, e); /* |b| < 2^54, and sum is below 2^8 * 2^10 */
        uint32_t i;
        for (i = 0; i < l->inputs; i++) {
            int64_t w = ROUND_SCALED(GET_U32(weights + 4 * i), e);
            if (MAGNITUDE(w) > WEIGHT_MAX)
                break;
            sum += MAGNITUDE(w);
            l->weight[row * l->inputs + i] = (int16_t)w;
        }
        if (i == l->inputs && sum * ACTIVATION_MAX + MAGNITUDE(b) + ((INT64_C(1) << e) >> 1) < ACCUMULATOR_BOUND) {
            l->bias[row] = (int32_t)b;
            l->exponent[row] = (uint8_t)e;
            return 1;
        }
    }
    return 0;
}

/* 6.8, 5.8: the values are known to be finite. In mode 0 they are at `at` in the file, which is `data`. */
static void DERIVE_NETWORKS(struct network *n, const uint8_t *values, uint64_t at, const uint8_t *data)
{
    uint64_t v = 0;
    for (int i = 0; i < OPACITY; i++)
        for (uint32_t k = 0; k < n[i].layers; k++) {
            struct layer *l = &n[i].layer[k];
            uint64_t biases = v + 4 * (uint64_t)l->outputs * l->inputs;
            l->weight = ALLOCATE((uint64_t)l->outputs * l->inputs, sizeof *l->weight);
            l->bias = ALLOCATE(l->outputs, sizeof *l->bias);
            l->exponent = ALLOCATE(l->outputs, 1);
            for (uint32_t r = 0; r < l->outputs; r++) {
                uint64_t row = v + 4 * (uint64_t)r * l->inputs;
                if (!DERIVE_ROW(values + row, GET_U32(values + biases + 4 * r), l, r))
                    REFUSE(WEIGHTS_BOUND, l->model ? (uint64_t)(l->model - data) : at + row);
            }
            v = biases + 4 * (uint64_t)l->outputs;
        }
}

/* 7.2 */
static int32_t ACTIVATION(int64_t a) { return (int32_t)CLAMP(a, -ACTIVATION_MAX, ACTIVATION_MAX); }

/* 7.2: accumulators stay below ACCUMULATOR_BOUND, so 32 bits hold them */
static void NETWORK(const struct network *n, const int32_t *inputs, int32_t *outputs)
{
    int32_t a[2][WIDTH_MAX];
    for (uint32_t k = 0; k < n->layers; k++) {
        const struct layer *l = &n->layer[k];
        int last = k + 1 == n->layers;
        int32_t *out = last ? outputs : a[k & 1];
        for (uint32_t r = 0; r < l->outputs; r++) {
            const int16_t *w = l->weight + r * l->inputs;
            int32_t sum = l->bias[r];
            for (uint32_t i = 0; i < l->inputs; i++)
                sum += w[i] * inputs[i];
            sum = (int32_t)RSHIFT_ROUND(sum, l->exponent[r]);
            out[r] = last ? sum : (int32_t)CLAMP(sum, 0, ACTIVATION_MAX);
        }
        inputs = out;
    }
}

/* ---------------------------------------------------------------- 8 entropy coder */

struct stream {
    uint64_t at; /* offset of the substream in the file */
    uint32_t expected_crc, symbol_crc, lanes, word_count;
    const uint8_t *words, *raw;
    uint64_t raw_length, word_at, raw_at; /* raw_length counts bytes, raw_at counts bits */
    int bad_escape, bad_range;
    uint32_t state[LANES_MAX];
};

/* 8.1, 5.14 */
static void OPEN(struct stream *s, const uint8_t *data, uint64_t at, uint64_t length, uint32_t lanes)
{
    const uint8_t *p = data + at;
    uint64_t words_at = 8 + 4 * (uint64_t)lanes, raw_at;
    if (length < words_at)
        REFUSE(SUBSTREAM_LENGTH, at);
    memset(s, 0, sizeof *s);
    s->at = at;
    s->lanes = lanes;
    s->expected_crc = GET_U32(p);
    s->word_count = GET_U32(p + 4);
    raw_at = words_at + 2 * (uint64_t)s->word_count;
    if (length < raw_at)
        REFUSE(SUBSTREAM_LENGTH, at);
    for (uint32_t n = 0; n < lanes; n++) {
        s->state[n] = GET_U32(p + 8 + 4 * n);
        if (s->state[n] < STATE_MIN)
            REFUSE(SUBSTREAM_STATE, at);
    }
    s->words = p + words_at;
    s->raw = p + raw_at;
    s->raw_length = length - raw_at;
}

/* 8.2, 8.3: STATE_MIN <= x < 2^32 holds before and after. In between x is at least 4 and below f * 2^18. */
static uint32_t DECODE_SYMBOL(struct stream *s, uint32_t lane, const uint16_t *frequency)
{
    uint32_t x = s->state[lane], slot = x & ((1 << PRECISION) - 1), low = 0, symbol = 0;
    while (slot >= low + frequency[symbol])
        low += frequency[symbol++];
    x = frequency[symbol] * (x >> PRECISION) + slot - low;
    if (x < STATE_MIN) {
        x = x << 16 | (s->word_at < s->word_count ? GET_U16(s->words + 2 * s->word_at) : 0);
        s->word_at++;
    }
    s->state[lane] = x;
    return symbol;
}

/* 8.8 */
static void NOTE_SYMBOL(struct stream *s, int32_t value)
{
    uint8_t b[4];
    PUT_U32(b, (uint32_t)value);
    s->symbol_crc = CRC32(s->symbol_crc, b, 4);
}

/* 8.5: for |mean| and |scale| below 2^25 */
static const struct model *SELECT(family f, int32_t mean, int32_t scale, int32_t *centre, unsigned *raw_bits)
{
    unsigned k = (unsigned)CLAMP(RSHIFT(scale - 24, 3) + 1, 0, RAW_MAX);
    int32_t row = (int32_t)CLAMP(scale - 8 * (int32_t)k, SCALE_MIN, SCALE_END - 1);
    int32_t h = (int32_t)RSHIFT_ROUND(mean - 8 * ((INT32_C(1) << k) - 1), k) + 8;
    *centre = (int32_t)RSHIFT(h, 4);
    *raw_bits = k;
    return &f[row - SCALE_MIN][h & 15];
}

/* 8.6, 8.7: for k <= 25 */
static uint32_t READ_BITS(struct stream *s, unsigned k)
{
    uint32_t value = 0;
    for (unsigned i = 0; i < k; i++, s->raw_at++)
        if (s->raw_at >> 3 < s->raw_length)
            value |= (uint32_t)(s->raw[s->raw_at >> 3] >> (s->raw_at & 7) & 1) << i;
    return value;
}

/* 8.7: the distance from the centre, which is below 2^26 + 2^8 in magnitude */
static int32_t READ_ESCAPE(struct stream *s, int32_t radius)
{
    uint32_t negative = READ_BITS(s, 1);
    unsigned z = 0;
    int32_t n = 1;
    while (z <= ESCAPE_PREFIX_MAX && !READ_BITS(s, 1))
        z++;
    if (z > ESCAPE_PREFIX_MAX)
        s->bad_escape = 1;
    else
        n = (int32_t)((UINT32_C(1) << z) + READ_BITS(s, z));
    return negative ? -(radius + n) : radius + n;
}

struct value { /* one value of a group */
    int32_t mean, scale, value;
    uint16_t low;
    uint8_t symbol;
};

/* 8.5 to 8.7: one group of values */
static void DECODE_VALUES(struct stream *s, family f, struct value *v, uint64_t count, int64_t limit)
{
    int32_t centre;
    unsigned k;
    for (uint64_t i = 0; i < count; i++)
        v[i].symbol = (uint8_t)DECODE_SYMBOL(s, (uint32_t)(i % s->lanes), SELECT(f, v[i].mean, v[i].scale, &centre, &k)->frequency);
    for (uint64_t i = 0; i < count; i++) {
        SELECT(f, v[i].mean, v[i].scale, &centre, &k);
        v[i].low = (uint16_t)READ_BITS(s, k);
    }
    for (uint64_t i = 0; i < count; i++) {
        int32_t radius = SELECT(f, v[i].mean, v[i].scale, &centre, &k)->radius;
        int32_t distance = v[i].symbol <= 2 * radius ? v[i].symbol - radius : READ_ESCAPE(s, radius);
        int64_t value = ((int64_t)centre + distance) * (INT64_C(1) << k) + v[i].low; /* below 2^43 in magnitude */
        if (MAGNITUDE(value) > limit) {
            s->bad_range = 1;
            value = 0;
        }
        v[i].value = (int32_t)value;
        NOTE_SYMBOL(s, v[i].value);
    }
}

/* 8.8 */
static void END(const struct stream *s)
{
    if (s->word_at != s->word_count)
        REFUSE(SUBSTREAM_WORDS, s->at);
    for (uint32_t n = 0; n < s->lanes; n++)
        if (s->state[n] != STATE_MIN)
            REFUSE(SUBSTREAM_FINAL_STATE, s->at);
    if (s->bad_escape)
        REFUSE(SUBSTREAM_ESCAPE, s->at);
    if (s->bad_range)
        REFUSE(SUBSTREAM_SYMBOL_RANGE, s->at);
    if (s->raw_length != (s->raw_at + 7) / 8)
        REFUSE(SUBSTREAM_RAW_LENGTH, s->at);
    if (s->raw_at % 8 && s->raw[s->raw_length - 1] >> (s->raw_at % 8))
        REFUSE(SUBSTREAM_RAW_PADDING, s->at);
    if (s->symbol_crc != s->expected_crc)
        REFUSE(SUBSTREAM_SYMBOL_CRC, s->at);
}

/* ---------------------------------------------------------------- the scene */

struct frame { /* 5.7 */
    int64_t matrix[9], translation[3], low[3], high[3];
    unsigned shift[3];
};

struct scene {
    const uint8_t *data;
    uint64_t length;
    struct header h;
    struct frame frame;
    struct network networks[NETWORKS];
    unsigned plane_shift;
    uint8_t carm_shift[255];
    const uint8_t *values; /* 5.8 */
    uint64_t value_count;
    uint32_t mask_model[55];
    unsigned cell_shift; /* 5.15 */
    uint16_t position_model[POSITION_MODELS][16];
    const uint8_t *entries; /* of type ChunkEntry, 5.10 */
    uint16_t *position_bits; /* three f16 of each anchor */
    int16_t *plane[5];      /* the sub-planes, [channel][i][j] */
    int16_t *plane_2;       /* the plane of r = 2 */
    uint8_t *masks;         /* K bits of each anchor, a byte each */
    struct value *group;    /* room for the largest group of a chunk */
    uint8_t *positions, *features, *scalings, *offsets; /* parts of the canonical reconstruction */
};

enum { S_FRAME, S_WEIGHTS, S_PLANES, S_CHUNK_TABLE, S_POSITIONS, S_MASKS, S_ATTRIBUTES, CRITICAL };

/* 5.6 */
static uint64_t SECTION(const struct scene *s, int section) { return s->h.directory[section].offset; }
/* 5.6 */
static uint64_t SECTION_LENGTH(const struct scene *s, int section) { return s->h.directory[section].length; }

/* 5.6 */
static int POSITION_MODE(const struct scene *s) { return s->h.directory[S_POSITIONS].mode; }

/* 6.6, 12.1 */
static void DIRECTORY(struct scene *s)
{
    const struct header *h = &s->h;
    const struct entry *d = h->directory;
    uint64_t k = h->offset_count, end = h->end, inputs = h->features - h->slice_width.item[h->slice_width.count - 1];
    uint64_t expected[CRITICAL] = {FRAME_LENGTH, UINT64_MAX, UINT64_MAX,
                                   k * (k + 1) + CHUNK_ENTRY_LENGTH * (uint64_t)h->chunks, UINT64_MAX, UINT64_MAX, UINT64_MAX};
    for (int i = 0; i < h->section_count; i++)
        if (d[i].type >= 0x80 && (d[i].type < 0x81 || d[i].type > 0x87))
            REFUSE(DIRECTORY_UNKNOWN_CRITICAL, d[i].at);
    for (int i = 0; i < h->section_count; i++) {
        int right = i < CRITICAL ? d[i].type == 0x81 + i
                                 : d[i].type >= 0x01 && d[i].type <= 0x7F && (i == CRITICAL || d[i].type > d[i - 1].type);
        if (!right)
            REFUSE(DIRECTORY_ORDER, d[i].at);
    }
    if (h->section_count < CRITICAL)
        REFUSE(DIRECTORY_ORDER, 22);
    for (int i = 0; i < CRITICAL; i++)
        if (d[i].mode > (i == S_WEIGHTS || i == S_POSITIONS))
            REFUSE(DIRECTORY_MODE, d[i].at + 1);
    if (!d[S_WEIGHTS].mode)
        expected[S_WEIGHTS] = 2 + inputs + 4 * s->value_count;
    if (POSITION_MODE(s))
        expected[S_CHUNK_TABLE] += POSITION_MODEL_LENGTH;
    else
        expected[S_POSITIONS] = 6 * (uint64_t)h->anchor_count;
    for (int i = 0; i < h->section_count; i++) {
        if (d[i].offset != end)
            REFUSE(DIRECTORY_OFFSET, d[i].at + 4);
        end += d[i].length;
    }
    for (int i = 0; i < CRITICAL; i++)
        if (expected[i] != UINT64_MAX && d[i].length != expected[i])
            REFUSE(DIRECTORY_LENGTH, d[i].at + 8);
    if (end != s->length)
        REFUSE(DIRECTORY_FILE_LENGTH, end < s->length ? end : s->length);
    for (int i = 0; i < h->section_count; i++)
        if (CRC32(0, s->data + d[i].offset, d[i].length) != d[i].crc)
            REFUSE(SECTION_CRC, d[i].offset);
}

/* 5.7, 6.7 */
static void FRAME(struct scene *s)
{
    struct frame *f = &s->frame;
    uint64_t at = SECTION(s, S_FRAME);
    const uint8_t *p = s->data + at;
    for (uint32_t i = 0; i < 9; i++) {
        f->matrix[i] = GET_I32(p + 4 * i);
        if (MAGNITUDE(f->matrix[i]) >= MATRIX_BOUND)
            REFUSE(FRAME_RANGE, at + 4 * i);
    }
    for (uint32_t i = 0; i < 3; i++) {
        f->translation[i] = GET_I64(p + 36 + 8 * i);
        if (f->translation[i] <= -TRANSLATION_BOUND || f->translation[i] >= TRANSLATION_BOUND)
            REFUSE(FRAME_RANGE, at + 36 + 8 * i);
    }
    for (uint32_t i = 0; i < 3; i++) {
        f->shift[i] = p[60 + i];
        if (f->shift[i] > FRAME_SHIFT_MAX)
            REFUSE(FRAME_RANGE, at + 60 + i);
    }
    if (p[63])
        REFUSE(FRAME_RANGE, at + 63);
    for (uint32_t i = 0; i < 3; i++) {
        f->low[i] = GET_I32(p + 64 + 4 * i);
        f->high[i] = GET_I32(p + 76 + 4 * i);
        if (f->low[i] < -FRAME_RANGE_BOUND || f->low[i] >= FRAME_RANGE_BOUND)
            REFUSE(FRAME_RANGE, at + 64 + 4 * i);
        if (f->high[i] <= f->low[i] || f->high[i] > FRAME_RANGE_BOUND)
            REFUSE(FRAME_RANGE, at + 76 + 4 * i);
    }
}

/* 5.16, R6.8-4, R6.8-5: reads the models of all layers. The result is where the substream begins. */
static uint64_t LAYER_MODELS(struct scene *s, uint64_t at)
{
    uint64_t section = SECTION(s, S_WEIGHTS), end = section + SECTION_LENGTH(s, S_WEIGHTS);
    for (int i = 0; i < NETWORKS; i++)
        for (uint32_t k = 0; k < s->networks[i].layers; k++) {
            struct layer *l = &s->networks[i].layer[k];
            const uint8_t *m = l->model = s->data + at;
            uint64_t bytes = 4 * (uint64_t)l->outputs * (l->inputs + 1);
            int64_t exponent;
            if (at + LAYER_MODEL_LENGTH > end)
                REFUSE(WEIGHTS_LENGTH, section);
            exponent = GET_I16(m + 1);
            if (m[0] > 1)
                REFUSE(WEIGHTS_LAYER, at);
            if (exponent < WEIGHT_EXPONENT_MIN || exponent > WEIGHT_EXPONENT_MAX)
                REFUSE(WEIGHTS_LAYER, at + 1);
            if (!m[0]) {
                if (exponent)
                    REFUSE(WEIGHTS_LAYER, at + 1);
                for (unsigned f = 3; f < LAYER_MODEL_LENGTH; f++)
                    if (m[f])
                        REFUSE(WEIGHTS_LAYER, at + f);
            }
            at += LAYER_MODEL_LENGTH;
            if (!m[0]) {
                if (at + bytes > end)
                    REFUSE(WEIGHTS_LENGTH, section);
                l->raw = s->data + at;
                at += bytes;
            }
        }
    return at;
}

/* 7.13: a finite f32 is +-n * 2^x with an odd n. For 0, n is 0. */
static uint32_t PARTS(uint32_t bits, int *x)
{
    uint32_t n = bits & 0x7FFFFF;
    int e = (int)(bits >> 23 & 255);
    if (e)
        n |= 0x800000;
    *x = (e ? e : 1) - 150;
    while (n && !(n & 1)) {
        n >>= 1;
        ++*x;
    }
    return n;
}

/* 7.13, R6.8-7: whether a layer with the finite values v can be packed */
static int CAN_BE_PACKED(const uint8_t *v, const struct layer *l)
{
    for (uint64_t r = 0; r < l->outputs; r++) {
        int least = 0, some = 0, x;
        for (int pass = 0; pass < 2; pass++)
            for (uint64_t i = 0; i <= l->inputs; i++) {
                uint32_t bits = GET_U32(v + 4 * (i < l->inputs ? r * l->inputs + i : (uint64_t)l->outputs * l->inputs + r)), n;
                if (bits == 0x80000000)
                    return 0;
                n = PARTS(bits, &x);
                if (!n)
                    continue;
                if (!pass) {
                    least = some && least > -x ? least : -x;
                    some = 1;
                } else if (least + x > 24 || (uint64_t)n << (least + x) > WEIGHT_SYMBOL_MAX)
                    return 0;
            }
        if (some && (least < WEIGHT_EXPONENT_MIN || least > WEIGHT_EXPONENT_MAX))
            return 0;
    }
    return 1;
}

/* 7.13: the bits of n * 2^-e, exactly, for |n| < 2^24 and the exponent e of a row */
static uint32_t ON_GRID(int32_t n, int64_t e)
{
    uint32_t m = (uint32_t)MAGNITUDE(n), sign = n < 0 ? UINT32_C(1) << 31 : 0;
    if (!m)
        return 0;
    while (!(m & 0x800000)) {
        m <<= 1;
        e++;
    }
    if (e >= 150)
        return sign | m >> (e - 149);
    return sign | (uint32_t)(150 - e) << 23 | (m & 0x7FFFFF);
}

/* 7.13: writes the values of one layer to v. few has its differences and its biases, many has its weights. */
static void PACKED_LAYER(const struct scene *s, const struct layer *l, const struct value *few, const struct value *many, uint8_t *v)
{
    uint64_t at = (uint64_t)(l->model - s->data), rows = l->outputs, inputs = l->inputs;
    int64_t e = GET_I16(l->model + 1);
    int first = 1;
    for (uint64_t r = 0; r < rows; r++) {
        int32_t difference = few[r].value, bias = few[rows + r].value;
        uint32_t any = (uint32_t)MAGNITUDE(bias);
        e += difference;
        for (uint64_t i = 0; i < inputs; i++)
            any |= (uint32_t)MAGNITUDE(many[r * inputs + i].value);
        if (e < WEIGHT_EXPONENT_MIN || e > WEIGHT_EXPONENT_MAX || (any && !(any & 1)) || (difference && (!any || first)))
            REFUSE(WEIGHTS_EXPONENT, at);
        first = first && !any;
        for (uint64_t i = 0; i < inputs; i++)
            PUT_U32(v + 4 * (r * inputs + i), ON_GRID(many[r * inputs + i].value, e));
        PUT_U32(v + 4 * (rows * inputs + r), ON_GRID(bias, e));
    }
    if (first && GET_I16(l->model + 1))
        REFUSE(WEIGHTS_EXPONENT, at);
}

/* 7.13, 6.8: the values in mode 1. The first LayerModel is at `at`. */
static void DECODE_WEIGHTS(struct scene *s, uint64_t at)
{
    uint8_t *values = ALLOCATE(s->value_count, 4), *v = values;
    struct value *few, *many;
    uint64_t few_count = 0, many_count = 0;
    struct stream stream;
    at = LAYER_MODELS(s, at);
    few = ALLOCATE(s->value_count + 1, 2 * sizeof *few); /* two for each row, which has at least one weight */
    many = ALLOCATE(s->value_count + 1, sizeof *many);
    OPEN(&stream, s->data, at, SECTION(s, S_WEIGHTS) + SECTION_LENGTH(s, S_WEIGHTS) - at, UINT32_C(1) << s->h.lanes_log2[2]);
    for (int i = 0; i < NETWORKS; i++)
        for (uint32_t k = 0; k < s->networks[i].layers; k++) {
            const struct layer *l = &s->networks[i].layer[k];
            if (l->raw)
                continue;
            for (uint32_t r = 0; r < 2 * l->outputs; r++)
                few[few_count++].scale = SCALE_MIN + l->model[r < l->outputs ? 3 : 5];
            for (uint64_t n = 0; n < (uint64_t)l->outputs * l->inputs; n++)
                many[many_count++].scale = SCALE_MIN + l->model[4];
        }
    DECODE_VALUES(&stream, LAPLACE, few, few_count, WEIGHT_SYMBOL_MAX);
    DECODE_VALUES(&stream, GAUSS, many, many_count, WEIGHT_SYMBOL_MAX);
    END(&stream);
    for (int i = 0; i < NETWORKS; i++)
        for (uint32_t k = 0; k < s->networks[i].layers; k++) {
            const struct layer *l = &s->networks[i].layer[k];
            uint64_t weights = (uint64_t)l->outputs * l->inputs, count = weights + l->outputs;
            if (l->raw) {
                for (uint64_t n = 0; n < count; n++)
                    if (!FINITE(GET_U32(l->raw + 4 * n)))
                        REFUSE(WEIGHTS_NOT_FINITE, (uint64_t)(l->raw - s->data) + 4 * n);
                if (CAN_BE_PACKED(l->raw, l))
                    REFUSE(WEIGHTS_RAW, (uint64_t)(l->model - s->data));
                memcpy(v, l->raw, (size_t)(4 * count));
            } else {
                PACKED_LAYER(s, l, few, many, v);
                few += 2 * l->outputs;
                many += weights;
            }
            v += 4 * count;
        }
    s->values = values;
}

/* 5.8, 6.8: in mode 0 the section is known to have the length of 6.6 */
static void WEIGHTS(struct scene *s)
{
    uint64_t at = SECTION(s, S_WEIGHTS), values_at;
    const uint8_t *p = s->data + at;
    uint32_t inputs = s->h.features - s->h.slice_width.item[s->h.slice_width.count - 1];
    if (SECTION_LENGTH(s, S_WEIGHTS) < 2 + inputs)
        REFUSE(WEIGHTS_LENGTH, at);
    s->plane_shift = p[0];
    if (s->plane_shift > PLANE_SHIFT_MAX)
        REFUSE(WEIGHTS_SCALE, at);
    if (p[1] != inputs)
        REFUSE(WEIGHTS_SCALE, at + 1);
    for (uint32_t i = 0; i < inputs; i++) {
        s->carm_shift[i] = p[2 + i];
        if (s->carm_shift[i] > CARM_SHIFT_MAX)
            REFUSE(WEIGHTS_SCALE, at + 2 + i);
    }
    values_at = at + 2 + inputs;
    if (s->h.directory[S_WEIGHTS].mode)
        DECODE_WEIGHTS(s, values_at);
    else {
        s->values = s->data + values_at;
        for (uint64_t i = 0; i < s->value_count; i++)
            if (!FINITE(GET_U32(s->values + 4 * i)))
                REFUSE(WEIGHTS_NOT_FINITE, values_at + 4 * i);
    }
    DERIVE_NETWORKS(s->networks, s->values, values_at, s->data);
}

/* ---------------------------------------------------------------- 7.3 planes */

/* 7.3: a symbol of a channel of a sub-plane, or 0 outside the sub-plane */
static int32_t AT(const int16_t *y, int32_t size, int32_t i, int32_t j)
{
    return i >= 0 && i < size && j >= 0 && j < size ? y[i * size + j] : 0;
}

/* 7.3: the groups are the wavefronts. Their points are in the order of channels, then of rows. */
static void DECODE_PLANE(struct stream *stream, const struct network *sarm, int32_t channels, int32_t size, int16_t *plane, struct value *group)
{
    for (int32_t t = 0; t < 3 * size - 2; t++) {
        /* the rows with 0 <= t - 2 i < size */
        int32_t first = t < size ? 0 : (t - size + 2) / 2, last = t / 2 < size ? t / 2 : size - 1;
        uint64_t count = 0;
        for (int32_t k = 0; k < channels; k++)
            for (int32_t i = first; i <= last; i++) {
                const int16_t *y = plane + k * size * size;
                int32_t j = t - 2 * i, out[2];
                int32_t near[4] = {ACTIVATION(AT(y, size, i - 1, j - 1)), ACTIVATION(AT(y, size, i - 1, j)),
                                   ACTIVATION(AT(y, size, i - 1, j + 1)), ACTIVATION(AT(y, size, i, j - 1))};
                NETWORK(sarm, near, out);
                group[count].mean = out[0];
                group[count++].scale = out[1];
            }
        DECODE_VALUES(stream, LAPLACE, group, count, PLANE_SYMBOL_MAX);
        count = 0;
        for (int32_t k = 0; k < channels; k++)
            for (int32_t i = first; i <= last; i++)
                plane[(k * size + i) * size + t - 2 * i] = (int16_t)group[count++].value;
    }
}

/* 5.9, 6.9 */
static void PLANES(struct scene *s)
{
    uint64_t at = SECTION(s, S_PLANES), length = SECTION_LENGTH(s, S_PLANES), sum = 20;
    const uint8_t *table = s->data + at;
    int32_t size = (int32_t)s->h.plane_size, channels = s->h.plane_channels;
    struct stream stream;
    struct value *group;
    if (length < 20)
        REFUSE(PLANES_LENGTH, at);
    for (int p = 0; p < 5; p++)
        sum += GET_U32(table + 4 * p);
    if (sum != length)
        REFUSE(PLANES_LENGTH, at);
    group = ALLOCATE((uint64_t)(channels * size), sizeof *group);
    at += 20;
    for (int p = 0; p < 5; p++) {
        s->plane[p] = ALLOCATE((uint64_t)(channels * size * size), sizeof **s->plane);
        OPEN(&stream, s->data, at, GET_U32(table + 4 * p), UINT32_C(1) << s->h.lanes_log2[0]);
        DECODE_PLANE(&stream, &s->networks[SARM], channels, size, s->plane[p], group);
        END(&stream);
        at += GET_U32(table + 4 * p);
    }
}

/* 7.5: the plane of r = 2 from its four sub-planes */
static void JOIN_QUADRANTS(struct scene *s)
{
    int32_t b = (int32_t)s->h.plane_size, channels = s->h.plane_channels;
    s->plane_2 = ALLOCATE((uint64_t)(channels * 4 * b * b), sizeof *s->plane_2);
    for (int32_t k = 0; k < channels; k++)
        for (int32_t i = 0; i < 2 * b; i++)
            for (int32_t j = 0; j < 2 * b; j++)
                s->plane_2[(k * 2 * b + i) * 2 * b + j] = s->plane[1 + 2 * (i >= b) + (j >= b)][(k * b + i % b) * b + j % b];
}

/* ---------------------------------------------------------------- 5.10, 6.10 chunks */

struct chunk {
    uint32_t first, anchors; /* 6.10 */
    uint64_t at[3], length[3]; /* of its parts of positions, masks, attributes */
    uint32_t crc[3];
};

/* 6.10: makes c the chunk of this index. c is the chunk before it, or anything if index is 0. */
static void NEXT_CHUNK(const struct scene *s, uint32_t index, struct chunk *c)
{
    const uint8_t *p = s->entries + CHUNK_ENTRY_LENGTH * (uint64_t)index;
    c->first = index * s->h.chunk_size;
    c->anchors = s->h.anchor_count - c->first < s->h.chunk_size ? s->h.anchor_count - c->first : s->h.chunk_size;
    for (int part = 0; part < 3; part++) {
        c->at[part] = index ? c->at[part] + c->length[part] : SECTION(s, S_POSITIONS + part);
        c->length[part] = GET_U32(p + 8 * part);
        c->crc[part] = GET_U32(p + 8 * part + 4);
    }
}

/* 5.15, R6.10-4 */
static void POSITION_MODEL(struct scene *s, uint64_t at)
{
    s->cell_shift = s->data[at];
    if (s->cell_shift > CELL_INDEX)
        REFUSE(CHUNKS_POSITION_MODEL, at);
    for (uint64_t m = 0; m < POSITION_MODELS; m++) {
        uint32_t sum = 0, right = 1;
        for (uint64_t i = 0; i < 16; i++) {
            uint32_t f = GET_U16(s->data + at + 1 + 32 * m + 2 * i);
            sum += f;
            right &= (f == 0) == (i == 0 && m % 6 == 1);
            s->position_model[m][i] = (uint16_t)f;
        }
        if (!right || sum != 1 << PRECISION)
            REFUSE(CHUNKS_POSITION_MODEL, at + 1 + 32 * m);
    }
}

/* 6.10 */
static void CHUNK_TABLE(struct scene *s)
{
    uint64_t at = SECTION(s, S_CHUNK_TABLE), sum[3] = {0, 0, 0};
    uint32_t numbers = s->h.offset_count * (s->h.offset_count + 1u) / 2;
    struct chunk c;
    for (uint32_t i = 0; i < numbers; i++) {
        s->mask_model[i] = GET_U16(s->data + at + 2 * i);
        if (s->mask_model[i] < 1 || s->mask_model[i] > (1 << PRECISION) - 1)
            REFUSE(CHUNKS_MASK_MODEL, at + 2 * i);
    }
    at += 2 * numbers;
    if (POSITION_MODE(s)) {
        POSITION_MODEL(s, at);
        at += POSITION_MODEL_LENGTH;
    }
    s->entries = s->data + at;
    for (uint32_t i = 0; i < s->h.chunks; i++) {
        NEXT_CHUNK(s, i, &c);
        if (POSITION_MODE(s) ? 16 * c.length[0] < c.anchors : c.length[0] != 6 * (uint64_t)c.anchors)
            REFUSE(CHUNKS_LENGTH, at + CHUNK_ENTRY_LENGTH * (uint64_t)i);
        for (int part = 0; part < 3; part++)
            sum[part] += c.length[part]; /* below 2^25 * 2^32 */
    }
    for (int part = 0; part < 3; part++)
        if (sum[part] != SECTION_LENGTH(s, S_POSITIONS + part))
            REFUSE(CHUNKS_LENGTH, SECTION(s, S_POSITIONS + part));
}

/* R6.10-3 */
static void CHUNK_CRC(const struct scene *s, const struct chunk *c, int part)
{
    if (CRC32(0, s->data + c->at[part], c->length[part]) != c->crc[part])
        REFUSE(CHUNKS_CRC, c->at[part]);
}

/* ---------------------------------------------------------------- 7.4, 7.5 positions and geometry to context */

/* 7.4: |P| < 2^40 */
static int64_t POSITION_INTEGER(uint32_t bits)
{
    uint32_t exponent = bits >> 10 & 31, mantissa = bits & 1023;
    int64_t p = exponent ? (int64_t)(mantissa + 1024) << (exponent - 1) : (int64_t)mantissa;
    return bits >> 15 ? -p : p;
}

/* 6.11: reads the f16 of a chunk, which are at `at` in the file */
static void RAW_POSITIONS(const struct scene *s, const struct chunk *c, uint64_t at)
{
    for (uint64_t i = 0; i < 3 * (uint64_t)c->anchors; i++) {
        uint32_t bits = GET_U16(s->data + at + 2 * i);
        if ((bits >> 10 & 31) == 31)
            REFUSE(POSITIONS_NOT_FINITE, at + 2 * i);
        if (bits == 0x8000)
            REFUSE(POSITIONS_NEGATIVE_ZERO, at + 2 * i);
        s->position_bits[3 * (uint64_t)c->first + i] = (uint16_t)bits;
    }
}

/* 7.12: -1 if there is none. |n| << cell_shift is below 2^55. */
static int32_t CELL_NUMBER(uint32_t c, unsigned cell_shift)
{
    int32_t n = (int32_t)c - (1 << (CELL_LEVELS - 1));
    uint64_t bits = (uint64_t)MAGNITUDE(n), p;
    if (cell_shift < CELL_INDEX) {
        unsigned e = 0;
        p = bits << cell_shift;
        while (p >> e >= 2048)
            e++;
        if (p >> e << e != p)
            return -1;
        bits = ((uint64_t)e << 10) + (p >> e);
    }
    if (bits >= 0x7C00)
        return -1;
    return (int32_t)bits | (n < 0 ? 0x8000 : 0);
}

/* 7.12: -1 if there is none */
static int32_t CELL_OF(uint32_t bits, unsigned cell_shift)
{
    int64_t n = bits & 0x7FFF, c;
    if (cell_shift < CELL_INDEX) {
        int64_t p = MAGNITUDE(POSITION_INTEGER(bits));
        n = p >> cell_shift;
        if (n << cell_shift != p)
            return -1;
    }
    c = (1 << (CELL_LEVELS - 1)) + (bits >> 15 ? -n : n);
    return c >= 0 && c < 1 << CELL_LEVELS ? (int32_t)c : -1;
}

/* 7.12: the result is below 2^48 */
static uint64_t MORTON(const uint16_t cell[3])
{
    uint64_t code = 0;
    for (unsigned i = 0; i < CELL_LEVELS; i++)
        for (unsigned axis = 0; axis < 3; axis++)
            code |= (uint64_t)(cell[axis] >> i & 1) << (3 * i + axis);
    return code;
}

/* R6.11-4: whether a raw chunk could be packed */
static int PACKS(const struct scene *s, const struct chunk *c)
{
    uint64_t before = 0;
    for (uint64_t n = 0; n < c->anchors; n++) {
        uint16_t cell[3];
        uint64_t code;
        for (int axis = 0; axis < 3; axis++) {
            int32_t found = CELL_OF(s->position_bits[3 * (c->first + n) + (uint64_t)axis], s->cell_shift);
            if (found < 0)
                return 0;
            cell[axis] = (uint16_t)found;
        }
        code = MORTON(cell);
        if (n && code <= before)
            return 0;
        before = code;
    }
    return 1;
}

/* 7.12: writes the cells to nodes. The result is whether there are as many cells as anchors. nodes, next and halves have
   room for the anchors. */
static int DECODE_CELLS(const struct scene *s, struct stream *stream, uint64_t anchors, uint16_t (*nodes)[3], uint16_t (*next)[3], uint8_t *halves)
{
    uint64_t count = 1, below;
    int whole = 1;
    memset(nodes[0], 0, sizeof nodes[0]);
    for (int level = CELL_LEVELS - 1; level >= 0; level--) {
        const uint16_t (*models)[16] = s->position_model + 6 * (level < 2 ? level : 2);
        for (uint64_t i = 0; i < count; i++) {
            halves[i] = (uint8_t)DECODE_SYMBOL(stream, (uint32_t)(i % stream->lanes), models[0]);
            NOTE_SYMBOL(stream, halves[i]);
        }
        below = 0;
        for (uint64_t i = 0; i < count; i++) {
            unsigned a = halves[i], b, named = (a & 1) + (a >> 1 & 1) + (a >> 2 & 1) + (a >> 3);
            b = DECODE_SYMBOL(stream, (uint32_t)(i % stream->lanes), models[1 + named]);
            NOTE_SYMBOL(stream, (int32_t)b);
            for (unsigned k = 0; k < 8; k++) {
                if (!((a | b << 4) >> k & 1))
                    continue;
                if (below == anchors) {
                    whole = 0;
                    continue;
                }
                for (unsigned axis = 0; axis < 3; axis++)
                    next[below][axis] = (uint16_t)(2 * nodes[i][axis] + (k >> axis & 1));
                below++;
            }
        }
        count = below;
        memcpy(nodes, next, (size_t)count * sizeof *nodes);
    }
    return whole && count == anchors;
}

/* 6.11, 7.12: a chunk in mode 1. nodes, next and halves are as for DECODE_CELLS. */
static void DECODE_POSITIONS(struct scene *s, const struct chunk *c, uint16_t (*nodes)[3], uint16_t (*next)[3], uint8_t *halves)
{
    uint64_t at = c->at[0], length = c->length[0];
    struct stream stream;
    int whole;
    if (length && s->data[at] == 1) {
        OPEN(&stream, s->data, at + 1, length - 1, UINT32_C(1) << s->h.lanes_log2[1]);
        whole = DECODE_CELLS(s, &stream, c->anchors, nodes, next, halves);
        END(&stream);
        if (!whole)
            REFUSE(POSITIONS_COUNT, at);
        for (uint64_t n = 0; n < c->anchors; n++)
            for (unsigned axis = 0; axis < 3; axis++) {
                int32_t bits = CELL_NUMBER(nodes[n][axis], s->cell_shift);
                if (bits < 0)
                    REFUSE(POSITIONS_CELL, at);
                s->position_bits[3 * (c->first + n) + axis] = (uint16_t)bits;
            }
        return;
    }
    if (length != 1 + 6 * (uint64_t)c->anchors || s->data[at])
        REFUSE(POSITIONS_FORM, at);
    RAW_POSITIONS(s, c, at + 1);
    if (PACKS(s, c))
        REFUSE(POSITIONS_RAW, at);
}

/* 5.11, 6.11, 9.1 */
static void POSITIONS(struct scene *s)
{
    uint64_t largest = s->h.anchor_count < s->h.chunk_size ? s->h.anchor_count : s->h.chunk_size;
    uint16_t (*nodes)[3] = ALLOCATE(largest + 1, sizeof *nodes), (*next)[3] = ALLOCATE(largest + 1, sizeof *next);
    uint8_t *halves = ALLOCATE(largest + 1, 1);
    struct chunk c;
    for (uint32_t n = 0; n < s->h.chunks; n++) {
        NEXT_CHUNK(s, n, &c);
        CHUNK_CRC(s, &c, 0);
        if (POSITION_MODE(s))
            DECODE_POSITIONS(s, &c, nodes, next, halves);
        else
            RAW_POSITIONS(s, &c, c.at[0]);
        for (uint64_t i = 3 * (uint64_t)c.first; i < 3 * ((uint64_t)c.first + c.anchors); i++) {
            /* below 2^62 + 2^56 in magnitude */
            int64_t world = s->h.origin[i % 3] + s->h.scale_mantissa * POSITION_INTEGER(s->position_bits[i]);
            PUT_U32(s->positions + 4 * i, ROUND_F32(world, s->h.scale_exponent - 24));
        }
    }
}

/* 7.5.1: products are below 2^60, and the sum with the rounding term is below 2^63 */
static void FRAME_COORDINATES(const struct frame *f, const int64_t p[3], int64_t v[3])
{
    for (int r = 0; r < 3; r++) {
        const int64_t *a = f->matrix + 3 * r;
        int64_t t = a[0] * p[0] + a[1] * p[1] + a[2] * p[2] + f->translation[r];
        v[r] = CLAMP(RSHIFT_ROUND(t, f->shift[r]), -FRAME_CLAMP, FRAME_CLAMP);
    }
}

/* 7.5.2: q < 2^62, (2 n - U) U < 2^48, v f < 2^47 */
static void CONTRACT(int64_t v[3])
{
    const int64_t unit = INT64_C(1) << UNIT_BITS;
    int64_t q = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], n, f;
    if (q <= unit * unit)
        return;
    n = ISQRT(q);
    f = (2 * n - unit) * unit / n;
    for (int r = 0; r < 3; r++)
        v[r] = FLOOR_DIV(v[r] * f, n);
}

/* 7.5.3 */
static void RESCALE(const struct frame *f, int64_t w[3])
{
    const int64_t unit = INT64_C(1) << UNIT_BITS;
    for (int r = 0; r < 3; r++)
        w[r] = CLAMP(FLOOR_DIV((w[r] - f->low[r]) * unit, f->high[r] - f->low[r]), 0, unit);
}

/* 7.5.4: g is below 2^25, and the sum with the rounding term is below 2^31 */
static void QUERY(const int16_t *plane, int32_t channels, int32_t size, const int64_t u[2], unsigned plane_shift, int32_t *out)
{
    int32_t cell[2], weight[2];
    for (int a = 0; a < 2; a++) {
        int32_t g = (int32_t)u[a] * (size - 1);
        int32_t c = g >> UNIT_BITS < size - 2 ? g >> UNIT_BITS : size - 2;
        cell[a] = c;
        weight[a] = (int32_t)RSHIFT_ROUND(g - (c << UNIT_BITS), UNIT_BITS - LERP_BITS);
    }
    for (int32_t k = 0; k < channels; k++) {
        const int16_t *y = plane + (k * size + cell[1]) * size + cell[0];
        int32_t fj = weight[0], fi = weight[1], one = 1 << LERP_BITS;
        int32_t t = y[0] * (one - fj) * (one - fi) + y[1] * fj * (one - fi) + y[size] * (one - fj) * fi + y[size + 1] * fj * fi;
        out[k] = ACTIVATION(RSHIFT_ROUND(t, 2 * LERP_BITS - plane_shift));
    }
}

/* 7.5.5: the phase is taken modulo one turn, so 32 unsigned bits suffice */
static void GAMMA(int64_t u, uint32_t frequencies, int32_t *out)
{
    for (uint32_t k = 0; k < frequencies; k++) {
        uint32_t phase = ((uint32_t)u - (UINT32_C(1) << (UNIT_BITS - 1))) << k & 0xFFFF;
        uint32_t turn = (phase + 32) >> 6;
        out[2 * k] = (int32_t)SINE[turn % SINE_LENGTH];
        out[2 * k + 1] = (int32_t)SINE[(turn + SINE_LENGTH / 4) % SINE_LENGTH];
    }
}

/* 7.5: the 2 ch + 2 L inputs of F_h for the anchor with the three f16 p */
static void CONTEXT(const struct scene *s, const uint16_t *p, int32_t *out)
{
    int32_t channels = s->h.plane_channels, size = (int32_t)s->h.plane_size;
    int64_t position[3], u[3];
    for (int a = 0; a < 3; a++)
        position[a] = POSITION_INTEGER(p[a]);
    FRAME_COORDINATES(&s->frame, position, u);
    CONTRACT(u);
    RESCALE(&s->frame, u);
    QUERY(s->plane[0], channels, size, u, s->plane_shift, out);
    QUERY(s->plane_2, channels, 2 * size, u, s->plane_shift, out + channels);
    GAMMA(u[2], s->h.frequency_count, out + 2 * channels);
}

/* ---------------------------------------------------------------- 7.6 masks */

/* 7.6: writes the K bits of each anchor */
static void DECODE_MASKS(struct stream *s, const uint32_t *mask_model, uint32_t offset_count, uint32_t anchors, uint8_t *masks)
{
    for (uint32_t k = 0; k < offset_count; k++)
        for (uint32_t n = 0; n < anchors; n++) {
            uint8_t *m = masks + (uint64_t)n * offset_count;
            uint32_t kept = 0, f;
            for (uint32_t i = 0; i < k; i++)
                kept += m[i];
            f = mask_model[k * (k + 1) / 2 + kept];
            m[k] = (uint8_t)DECODE_SYMBOL(s, n % s->lanes, (const uint16_t[2]){(uint16_t)((1 << PRECISION) - f), (uint16_t)f});
            NOTE_SYMBOL(s, m[k]);
        }
}

/* 5.12, 6.12 */
static void MASKS(struct scene *s)
{
    struct chunk c;
    struct stream stream;
    for (uint32_t n = 0; n < s->h.chunks; n++) {
        NEXT_CHUNK(s, n, &c);
        CHUNK_CRC(s, &c, 1);
        OPEN(&stream, s->data, c.at[1], c.length[1], UINT32_C(1) << s->h.lanes_log2[1]);
        DECODE_MASKS(&stream, s->mask_model, s->h.offset_count, c.anchors, s->masks + (uint64_t)c.first * s->h.offset_count);
        END(&stream);
    }
}

/* ---------------------------------------------------------------- 7.7 to 7.10 attributes */

/* 7.10, 7.7: decodes the group of channels first to first + width - 1 of all anchors of a chunk. For each anchor,
   parameters has the outputs of F_h, change has the outputs of CARM unless it is a null pointer, and symbols has D
   symbols. */
static void DECODE_STAGE(struct scene *s, struct stream *stream, const struct chunk *c, uint32_t first, uint32_t width,
                         const int32_t *parameters, const int32_t *change, int32_t *symbols)
{
    uint32_t d = s->h.channels, kinds = s->h.features + 6;
    uint64_t count = 0;
    for (int pass = 0; pass < 2; pass++) {
        for (uint64_t n = 0; n < c->anchors; n++) {
            const uint8_t *mask = s->masks + (c->first + n) * s->h.offset_count;
            for (uint32_t i = 0; i < width; i++) {
                uint32_t channel = first + i;
                if (channel >= kinds && !mask[(channel - kinds) / 3])
                    continue;
                if (pass) {
                    symbols[n * d + channel] = s->group[count++].value;
                    continue;
                }
                s->group[count].mean = parameters[n * (2 * d + 3) + channel] + (change ? change[n * 2 * width + i] : 0);
                s->group[count++].scale = parameters[n * (2 * d + 3) + d + channel] + (change ? change[n * 2 * width + width + i] : 0);
            }
        }
        if (!pass)
            DECODE_VALUES(stream, GAUSS, s->group, count, ATTRIBUTE_SYMBOL_MAX);
        count = 0;
    }
}

/* 7.9: writes the outputs of CARM for slice i, which begins at channel `first` */
static void CHANNEL_CONTEXT(const struct scene *s, uint32_t i, uint32_t first, uint64_t anchors, const int32_t *symbols, int32_t *change)
{
    int32_t inputs[WIDTH_MAX];
    for (uint64_t n = 0; n < anchors; n++) {
        for (uint32_t k = 0; k < first; k++)
            inputs[k] = ACTIVATION(RSHIFT_ROUND(symbols[n * s->h.channels + k], s->carm_shift[k]));
        NETWORK(&s->networks[CARM_1 + i - 1], inputs, change + n * 2 * s->h.slice_width.item[i]);
    }
}

/* 9.2: the base step is m * 2^e, with m below 2^24. The product is below 2^63. */
static uint32_t VALUE(int32_t symbol, int64_t step_index, uint32_t base_step)
{
    int64_t m;
    int e;
    SPLIT_F32(base_step, &m, &e);
    return ROUND_F32(symbol * STEP[step_index] * m, e - STEP_SHIFT);
}

/* 7.8, 9.2: writes channels first to first + width - 1 of a chunk's anchors. They are of kind a. */
static void RECONSTRUCT(const struct scene *s, const struct chunk *c, int a, uint32_t first, uint32_t width, const int32_t *parameters,
                        const int32_t *symbols, uint8_t *part)
{
    uint64_t d = s->h.channels;
    part += 4 * (uint64_t)c->first * width;
    for (uint64_t n = 0; n < c->anchors; n++) {
        int64_t index = CLAMP(parameters[n * (2 * d + 3) + 2 * d + (uint64_t)a], 0, STEP_LENGTH - 1);
        for (uint32_t i = 0; i < width; i++, part += 4)
            PUT_U32(part, VALUE(symbols[n * d + first + i], index, s->h.base_step[a]));
    }
}

/* 5.13, 7.7, 7.10 */
static void ATTRIBUTES(struct scene *s)
{
    const struct header *h = &s->h;
    uint64_t d = h->channels, largest = h->anchor_count < h->chunk_size ? h->anchor_count : h->chunk_size;
    uint32_t k3 = 3u * h->offset_count;
    int32_t *parameters = ALLOCATE(largest * (2 * d + 3), sizeof *parameters);
    int32_t *change = ALLOCATE(largest * 2 * 64, sizeof *change); /* slice_width <= 64 */
    int32_t *symbols = ALLOCATE(largest * d, sizeof *symbols);
    struct chunk c;
    struct stream stream;
    s->group = ALLOCATE(largest * d, sizeof *s->group);
    for (uint32_t i = 0; i < h->chunks; i++) {
        uint32_t first = 0;
        NEXT_CHUNK(s, i, &c);
        CHUNK_CRC(s, &c, 2);
        OPEN(&stream, s->data, c.at[2], c.length[2], UINT32_C(1) << h->lanes_log2[2]);
        for (uint64_t n = 0; n < c.anchors; n++) {
            int32_t context[WIDTH_MAX];
            CONTEXT(s, s->position_bits + 3 * (c.first + n), context);
            NETWORK(&s->networks[HYPER], context, parameters + n * (2 * d + 3));
        }
        memset(symbols, 0, (size_t)(c.anchors * d * sizeof *symbols));
        for (uint32_t slice = 0; slice < h->slice_width.count; slice++) {
            uint32_t width = h->slice_width.item[slice];
            if (slice)
                CHANNEL_CONTEXT(s, slice, first, c.anchors, symbols, change);
            DECODE_STAGE(s, &stream, &c, first, width, parameters, slice ? change : NULL, symbols);
            first += width;
        }
        DECODE_STAGE(s, &stream, &c, first, 6, parameters, NULL, symbols);
        DECODE_STAGE(s, &stream, &c, first + 6, k3, parameters, NULL, symbols);
        END(&stream);
        RECONSTRUCT(s, &c, 0, 0, first, parameters, symbols, s->features);
        RECONSTRUCT(s, &c, 1, first, 6, parameters, symbols, s->scalings);
        RECONSTRUCT(s, &c, 2, first + 6, k3, parameters, symbols, s->offsets);
    }
}

/* ---------------------------------------------------------------- 9.3 canonical reconstruction */

enum { PART_COUNT = 8, HEAD_LENGTH = 28 };
struct part {
    const char *name;
    const uint8_t *data;
    uint64_t length;
};

/* 9.3 */
static void CANONICAL(const struct scene *s, struct part part[PART_COUNT])
{
    const struct header *h = &s->h;
    uint64_t n = h->anchor_count, k = h->offset_count, points = (uint64_t)h->plane_channels * h->plane_size * h->plane_size;
    uint8_t *head = ALLOCATE(HEAD_LENGTH, 1), *planes = ALLOCATE(5 * points, 2);
    uint32_t numbers[5] = {h->anchor_count, h->offset_count, h->features, h->plane_channels, h->plane_size};
    memcpy(head, "C3GSREC0", 8);
    for (int i = 0; i < 5; i++)
        PUT_U32(head + 8 + 4 * i, numbers[i]);
    for (uint64_t p = 0; p < 5; p++)
        for (uint64_t i = 0; i < points; i++)
            PUT_U16(planes + 2 * (p * points + i), (uint16_t)s->plane[p][i]);
    part[0] = (struct part){"head", head, HEAD_LENGTH};
    part[1] = (struct part){"positions", s->positions, 12 * n};
    part[2] = (struct part){"masks", s->masks, n * k};
    part[3] = (struct part){"planes", planes, 10 * points};
    part[4] = (struct part){"features", s->features, 4 * n * h->features};
    part[5] = (struct part){"scalings", s->scalings, 24 * n};
    part[6] = (struct part){"offsets", s->offsets, 12 * n * k};
    part[7] = (struct part){"weights", s->values, 4 * s->value_count};
}

/* 9.3: prints the digest of the whole, and then that of each part but the head */
static int DIGEST(const struct part part[PART_COUNT])
{
    struct sha256 s;
    char hex[65];
    SHA_START(&s);
    for (int i = 0; i < PART_COUNT; i++)
        SHA_ADD(&s, part[i].data, part[i].length);
    SHA_END(&s, hex);
    printf("whole %s\n", hex);
    for (int i = 1; i < PART_COUNT; i++) {
        SHA_START(&s);
        SHA_ADD(&s, part[i].data, part[i].length);
        SHA_END(&s, hex);
        printf("%s %s\n", part[i].name, hex);
    }
    return fflush(stdout) == 0 && !ferror(stdout);
}

/* 9.3: writes the reconstruction */
static int WRITE(const struct part part[PART_COUNT], const char *name)
{
    FILE *f = fopen(name, "wb");
    int right = f != NULL;
    for (int i = 0; right && i < PART_COUNT; i++)
        right = !part[i].length || fwrite(part[i].data, 1, (size_t)part[i].length, f) == part[i].length;
    if (f && fclose(f))
        right = 0;
    return right;
}

/* 2.1, 7.1, 10.1: the order of decoding and of checks */
static void DECODE_SCENE(struct scene *s)
{
    PROLOGUE(&s->h, s->data, s->length);
    HEADER(&s->h, s->data);
    SHAPES(&s->h, s->networks);
    s->value_count = VALUE_COUNT(s->networks);
    DIRECTORY(s); /* from here on the length of the file bounds C */
    FRAME(s);
    WEIGHTS(s);
    PLANES(s);
    JOIN_QUADRANTS(s);
    CHUNK_TABLE(s); /* from here on it bounds N too */
    s->position_bits = ALLOCATE(s->h.anchor_count, 6);
    s->positions = ALLOCATE(s->h.anchor_count, 12);
    POSITIONS(s);
    s->masks = ALLOCATE(s->h.anchor_count, s->h.offset_count);
    MASKS(s);
    s->features = ALLOCATE(s->h.anchor_count, 4 * s->h.features);
    s->scalings = ALLOCATE(s->h.anchor_count, 24);
    s->offsets = ALLOCATE(s->h.anchor_count, 12u * s->h.offset_count);
    ATTRIBUTES(s);
}

/* not of the specification */
static const uint8_t *READ_FILE(const char *name, uint64_t *length)
{
    FILE *f = fopen(name, "rb");
    uint64_t room = 1 << 16, n = 0, got;
    uint8_t *data;
    if (!f)
        FAIL("cannot open the file");
    data = ALLOCATE(room, 1);
    while ((got = fread(data + n, 1, (size_t)(room - n), f)) > 0) {
        n += got;
        if (n == room) { /* nothing else was allocated meanwhile, so the old block is the head of the list */
            struct block *old = blocks;
            uint8_t *larger = ALLOCATE(2 * room, 1);
            memcpy(larger, data, (size_t)n);
            blocks->next = old->next;
            free(old);
            data = larger;
            room *= 2;
        }
    }
    if (ferror(f)) {
        fclose(f);
        FAIL("cannot read the file");
    }
    fclose(f);
    *length = n;
    return data;
}

/* not of the specification */
int main(int argc, char **argv)
{
    static struct scene s;
    struct part part[PART_COUNT];
    const char *tables = getenv("C3GS_TABLES"), *slash;
    uint64_t length;
    const uint8_t *data;
    int decode = argc == 4 && !strcmp(argv[1], "decode");
    if (!decode && (argc != 3 || strcmp(argv[1], "digest")))
        FAIL("usage: decoder digest FILE | decoder decode FILE OUTPUT");
    MAKE_CRC_TABLE();
    if (!tables) {
        size_t folder = (slash = strrchr(argv[0], '/')) ? (size_t)(slash - argv[0]) + 1 : 0;
        char *path = ALLOCATE(folder + 16, 1);
        memcpy(path, argv[0], folder);
        memcpy(path + folder, "tables-0.bin", 13);
        tables = path;
    }
    data = READ_FILE(tables, &length);
    READ_TABLES(data, length);
    s.data = READ_FILE(argv[2], &s.length);
    DECODE_SCENE(&s);
    CANONICAL(&s, part);
    if (!(decode ? WRITE(part, argv[3]) : DIGEST(part)))
        FAIL("cannot write");
    RELEASE();
    return 0;
}
