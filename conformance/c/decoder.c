/* A decoder for C3GS, format version 0, written from SPEC.md alone.
 *
 *   decoder digest FILE           prints the digests of the canonical reconstruction (9.3)
 *   decoder decode FILE OUTPUT [PROBES]
 *                                 writes the bytes that the scene's digest is the SHA-256 of, and then the parts
 *
 * It reads FILE from the first byte to the last, and holds one section or one chunk at a time. To be digested, FILE may
 * be a pipe. OUTPUT is written in a second pass, beside its place, and moved there when it is whole. So a run that fails
 * leaves it alone. No output is FILE or another output. POSIX says which names are one file, and
 * has the signal of a file that is too long: the rest is ISO C.
 *
 * The exit status is:
 *
 *   0   done
 *   1   the file is malformed or invalid
 *   2   the file is not supported
 *   64  wrong usage, or a failure of input, output or memory
 *
 * PROBES is a trace of probes alone: the numbers of each anchor by name (conformance/README.md). Those before an error
 * are written too; without any, it is left alone. There are 16 MiB at most.
 *
 * With status 1 or 2 the last line on stderr is {"code": 202, "name": "header.crc", "offset": 300}. The tables of Annex
 * A are read from the file that the environment variable C3GS_TABLES names, or else from tables-0.bin in the folder of
 * the program.
 *
 * The comment above a function begins with its clauses of SPEC.md. Names are those of SPEC.md where it has one.
 */
#define _XOPEN_SOURCE 700
#include <ctype.h>
#include <limits.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

/* ---------------------------------------------------------------- 2.5 constants */

enum {
    MAJOR = 0,
    MINOR = 0,
    HEADER_LENGTH_MIN = 4,
    HEADER_LENGTH_MAX = 65532,
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
    ESCAPE_PREFIX_MAX = 23,
    SCALE_MIN = -40,
    SCALE_END = 24,
    FRACTIONS = 16,
    SINE_LENGTH = 1024,
    STEP_LENGTH = 64,
    STEP_SHIFT = 12,
    OUTPUT_BITS = 12,
    SCALING_BITS = 16,
    SCALING_BOUND = 27 << SCALING_BITS,
    /* 6.5: a render_model */
    STATIC = 1,
    ANCHORS_OF_A_BYTE = 16,
    /* 11.1 */
    FEATURES_MAX = 128,
    OFFSETS_MAX = 16,
    SLICES_MAX = 16,
    SLICE_WIDTH_MAX = 64,
    COLOURS_MAX = 48,
    ALPHA_LIMIT = 0x3F7D70A4,
    /* A, 5 */
    TABLES_LENGTH = 99840,
    PROLOGUE_LENGTH = 20,
    FIXED_LENGTH = 98,
    DIRECTORY_ENTRY_LENGTH = 20,
    FRAME_LENGTH = 88,
    LAYER_MODEL_LENGTH = 8,
    PLANE_TABLE_LENGTH = 20,
    POSITION_MODEL_LENGTH = 580,
    CHUNK_ENTRY_LENGTH = 28,
    CHUNK_HEAD_LENGTH = 16,
    SECTIONS_MAX = HEADER_LENGTH_MAX / DIRECTORY_ENTRY_LENGTH
};
#define SECTION_LENGTH_MAX (UINT64_C(1) << 48)
#define ORIGIN_BOUND (INT64_C(1) << 62)
#define TRANSLATION_BOUND (INT64_C(1) << 61)
#define BASE_STEP_MIN 0x1p-60f
#define BASE_STEP_MAX 0x1p60f

/* ---------------------------------------------------------------- 10.3 registry */

enum class { MALFORMED, INVALID, UNSUPPORTED };

#define REGISTRY(X)                                                                                                    \
    X(101, PROLOGUE_TRUNCATED, MALFORMED) X(102, PROLOGUE_SIGNATURE, MALFORMED) X(103, PROLOGUE_CRC, MALFORMED)        \
    X(104, PROLOGUE_VERSION, UNSUPPORTED) X(105, PROLOGUE_HEADER_LENGTH, MALFORMED)                                    \
    X(201, HEADER_TRUNCATED, MALFORMED) X(202, HEADER_CRC, MALFORMED) X(203, HEADER_SYNTAX, MALFORMED)                 \
    X(204, HEADER_RESERVED, UNSUPPORTED) X(205, HEADER_PROFILE, UNSUPPORTED) X(206, HEADER_LEVEL, UNSUPPORTED)         \
    X(207, HEADER_DIMENSION, INVALID) X(208, HEADER_ANCHOR_COUNT, INVALID) X(209, HEADER_LEVEL_NOT_MINIMAL, INVALID)   \
    X(210, HEADER_CHUNK_SIZE, INVALID) X(211, HEADER_LANES, INVALID) X(212, HEADER_BASE_STEP, INVALID)                 \
    X(213, HEADER_POSITION_GRID, INVALID) X(214, HEADER_RENDER_INFO, INVALID) X(215, HEADER_WORK, INVALID)             \
    X(216, HEADER_PADDING, MALFORMED) X(217, HEADER_CHUNK_COUNT, INVALID)                                              \
    X(301, DIRECTORY_TYPE, MALFORMED) X(302, DIRECTORY_UNKNOWN_CRITICAL, UNSUPPORTED)                                  \
    X(303, DIRECTORY_ORDER, MALFORMED) X(304, DIRECTORY_MODE, UNSUPPORTED) X(305, DIRECTORY_LENGTH, MALFORMED)         \
    X(311, SECTION_TRUNCATED, MALFORMED) X(312, SECTION_CRC, MALFORMED) X(313, SECTION_PADDING, MALFORMED)             \
    X(321, FILE_TRAILING, MALFORMED)                                                                                   \
    X(401, FRAME_RANGE, INVALID) X(402, FRAME_RESERVED, UNSUPPORTED)                                                   \
    X(411, WEIGHTS_SCALE, INVALID) X(412, WEIGHTS_NOT_FINITE, INVALID) X(413, WEIGHTS_BOUND, INVALID)                  \
    X(414, WEIGHTS_LENGTH, MALFORMED) X(415, WEIGHTS_LAYER, INVALID) X(416, WEIGHTS_EXPONENT, INVALID)                 \
    X(417, WEIGHTS_PADDING, MALFORMED) X(418, WEIGHTS_RESERVED, UNSUPPORTED)                                           \
    X(421, PLANES_LENGTH, MALFORMED) X(422, PLANES_PADDING, MALFORMED)                                                 \
    X(431, INDEX_MASK_MODEL, INVALID) X(432, INDEX_POSITION_MODEL, INVALID) X(433, INDEX_CHUNK, INVALID)               \
    X(434, INDEX_LENGTH, MALFORMED) X(435, INDEX_PADDING, MALFORMED) X(436, INDEX_RESERVED, UNSUPPORTED)               \
    X(441, CHUNK_CRC, MALFORMED) X(442, CHUNK_LENGTH, MALFORMED) X(443, CHUNK_FORM, MALFORMED)                         \
    X(444, CHUNK_PADDING, MALFORMED) X(445, CHUNK_RESERVED, UNSUPPORTED) X(446, CHUNK_KEPT, INVALID)                   \
    X(447, CHUNK_BOUNDS, INVALID)                                                                                      \
    X(451, POSITIONS_NOT_FINITE, INVALID) X(452, POSITIONS_NEGATIVE_ZERO, INVALID) X(453, POSITIONS_COUNT, INVALID)    \
    X(454, POSITIONS_CELL, INVALID)                                                                                    \
    X(501, SUBSTREAM_LENGTH, MALFORMED) X(502, SUBSTREAM_STATE, INVALID) X(503, SUBSTREAM_WORDS, INVALID)              \
    X(504, SUBSTREAM_FINAL_STATE, INVALID) X(505, SUBSTREAM_ESCAPE, INVALID) X(506, SUBSTREAM_SYMBOL_RANGE, INVALID)   \
    X(507, SUBSTREAM_RAW_LENGTH, INVALID) X(508, SUBSTREAM_RAW_PADDING, INVALID) X(509, SUBSTREAM_SYMBOL_CRC, INVALID)

#define CODE(code, name, class) name = code,
#define KIND(code, name, class) {name, #name, class},
enum error { REGISTRY(CODE) };
static const struct {
    enum error code;
    const char *name; /* in capitals, with `_` in the place of `.` */
    enum class class;
} registry[] = {REGISTRY(KIND)};

enum { STATUS_REFUSED = 1, STATUS_UNSUPPORTED = 2, STATUS_USAGE = 64 };

/* ---------------------------------------------------------------- memory, input and output */

/* All allocated memory, so that every exit can release it. BLOCKS_MAX is more than a file needs: three for each of 57
   layers, and about 30 others. */
enum { BLOCKS_MAX = 256 };
static void *blocks[BLOCKS_MAX]; /* or null pointers */

static FILE *input, *output, *probes; /* null pointers if they are not open */
/* where an output will be, and where it is until it is whole; or null pointers */
static struct outgoing {
    FILE **file;
    char *place, *beside;
} made = {&output, NULL, NULL}, traced = {&probes, NULL, NULL};
static uint64_t input_at; /* the bytes that were read of the file */
static uint64_t probed;   /* bytes, no less than were written of probes */

/* not of the specification */
static void RELEASE_BLOCKS(void)
{
    for (int i = 0; i < BLOCKS_MAX; i++) {
        free(blocks[i]);
        blocks[i] = NULL;
    }
}

/* not of the specification: releases all that the program holds, and removes an output that is not whole */
static void RELEASE(void)
{
    RELEASE_BLOCKS();
    if (input)
        fclose(input);
    input = NULL;
    for (struct outgoing *o = &made; o; o = o == &made ? &traced : NULL) {
        if (*o->file)
            fclose(*o->file);
        if (o->beside)
            remove(o->beside);
        free(o->place);
        free(o->beside);
        *o->file = NULL;
        o->place = o->beside = NULL;
    }
}

/* not of the specification: ends the program for wrong usage, or for a failure of input, output or memory */
_Noreturn static void FAIL(const char *message)
{
    fprintf(stderr, "decoder: %s\n", message);
    RELEASE();
    exit(STATUS_USAGE);
}

/* not of the specification */
#define FAIL_IF(wrong, message) ((wrong) ? FAIL(message) : (void)0)

/* not of the specification: an output is whole */
static void CLOSE_OUTPUT(struct outgoing *o)
{
    int wrong = ferror(*o->file) | fclose(*o->file);
    *o->file = NULL;
    FAIL_IF(wrong || (o->beside && rename(o->beside, o->place)), "cannot write");
    free(o->beside);
    o->beside = NULL;
}

/* not of the specification: says again what earlier checks give, where an access or an operation depends on it. A
   mistake in them is then no undefined behaviour. */
#define SURE(condition) FAIL_IF(!(condition), "a check is missing: please report this file")

/* 10.1, 10.2: the first error ends the decoding */
_Noreturn static void REFUSE(enum error code, uint64_t offset)
{
    size_t i = 0, dot = 0;
    while (i + 1 < sizeof registry / sizeof *registry && registry[i].code != code)
        i++;
    fprintf(stderr, "{\"code\": %d, \"name\": \"", (int)code);
    for (const char *c = registry[i].name; *c; c++)
        putc(*c == '_' && !dot++ ? '.' : tolower((unsigned char)*c), stderr);
    fprintf(stderr, "\", \"offset\": %llu}\n", (unsigned long long)offset);
    if (probes && probed)
        CLOSE_OUTPUT(&traced);
    RELEASE();
    exit(registry[i].class == UNSUPPORTED ? STATUS_UNSUPPORTED : STATUS_REFUSED);
}

/* 10.1: as REQUIRE of SPEC.md, but for the condition of a wrong file */
#define REFUSE_IF(wrong, code, offset) ((wrong) ? REFUSE(code, offset) : (void)0)

/* 13.1: a block of zeros. Callers have checked the size against the file or the level: count < 2^32, size < 2^16. */
static void *ALLOCATE(uint64_t count, uint64_t size)
{
    uint64_t bytes = count * size;
    int i = 0;
    while (i < BLOCKS_MAX && blocks[i])
        i++;
    SURE(i < BLOCKS_MAX);
    if (bytes <= SIZE_MAX)
        blocks[i] = calloc(bytes ? (size_t)bytes : 1, 1);
    FAIL_IF(!blocks[i], "out of memory");
    return blocks[i];
}

/* 13.1 */
static void FREE(void *p)
{
    for (int i = 0; i < BLOCKS_MAX; i++)
        if (blocks[i] == p)
            blocks[i] = NULL;
    free(p);
}

struct buffer { /* room for bytes of the file; data is a block */
    uint8_t *data;
    uint64_t room;
};

struct piece { /* bytes of the file; `at` is the offset of the first of them */
    const uint8_t *data;
    uint64_t at, length;
};

/* 13.1: reads the next n bytes. The piece has fewer if the file ends before, and so input_at is the file's length then.
   The buffer grows with the bytes that are there, because nobody has checked n against the file. */
static struct piece READ(struct buffer *b, uint64_t n)
{
    struct piece p = {NULL, input_at, 0};
    for (;;) {
        uint64_t room = p.length ? 2 * p.length : 1 << 16, got;
        if (b->room < room) {
            uint8_t *data = ALLOCATE(room, 1);
            if (b->data) {
                memcpy(data, b->data, (size_t)p.length);
                FREE(b->data);
            }
            b->data = data;
            b->room = room;
        }
        p.data = b->data;
        room = b->room < n ? b->room : n;
        got = fread(b->data + p.length, 1, (size_t)(room - p.length), input);
        p.length += got;
        input_at += got;
        FAIL_IF(ferror(input), "cannot read the file");
        if (p.length == n || !got)
            return p;
    }
}

/* 5: n rounded up to a multiple of 4, for n below 2^63 */
static uint64_t PAD4(uint64_t n) { return (n + 3) / 4 * 4; }

/* 5: whether the bytes from `from` to `end` of a piece are zero */
static int ZERO(struct piece p, uint64_t from, uint64_t end)
{
    while (from < end && !p.data[from])
        from++;
    return from >= end;
}

/* 5: a part of a piece */
static struct piece CUT(struct piece p, uint64_t from, uint64_t length)
{
    struct piece cut = {p.data + from, p.at + from, length};
    return cut;
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
    return v <= INT64_MAX ? (int64_t)v : -(int64_t)(~v) - 1;
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

/* 2.4 */
static int IS_FINITE(uint32_t bits) { return (bits >> 23 & 255) != 255; }

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

/* 2.4: a result of 2^53 or more in magnitude may be inexact, because no bound of 7.2 and no limit of 9.4 allows it */
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
    uint64_t a = n < 0 ? 0 - (uint64_t)n : (uint64_t)n, m = a;
    int s = 0, zeros = 0;
    if (!a)
        return 0;
    while (s < 40 && a >> s >> 24)
        s++;
    if (s) {
        m = (a + (UINT64_C(1) << (s - 1))) >> s;
        if ((a & ((UINT64_C(1) << s) - 1)) == UINT64_C(1) << (s - 1))
            m &= ~UINT64_C(1);
    }
    e += s;
    while (zeros < 23 && m << zeros < UINT64_C(1) << 23)
        zeros++;
    m <<= zeros;
    e -= zeros;
    if (m >= UINT64_C(1) << 24) { /* only 2^24, after a carry */
        m >>= 1;
        e++;
    }
    return (n < 0 ? UINT32_C(1) << 31 : 0) | (uint32_t)(e + 150) << 23 | ((uint32_t)m & 0x7FFFFF);
}

/* ---------------------------------------------------------------- 2.3 CRC-32; 9.3 SHA-256 (FIPS 180-4) */

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
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};

/* 9.3 */
static uint32_t ROTR(uint32_t x, int n) { return x >> n | x << (32 - n); }

/* 9.3 */
static void SHA_START(struct sha256 *s)
{
    static const uint32_t h[8] = {
        0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    memset(s, 0, sizeof *s);
    memcpy(s->h, h, sizeof h);
}

/* 9.3 */
static void SHA_BLOCK(struct sha256 *s)
{
    uint32_t w[64] = {0}, v[8];
    for (int i = 0; i < 16; i++)
        for (int byte = 0; byte < 4; byte++)
            w[i] = w[i] << 8 | s->block[4 * i + byte];
    for (int i = 16; i < 64; i++)
        w[i] = w[i - 16] + (ROTR(w[i - 15], 7) ^ ROTR(w[i - 15], 18) ^ w[i - 15] >> 3) + w[i - 7] +
               (ROTR(w[i - 2], 17) ^ ROTR(w[i - 2], 19) ^ w[i - 2] >> 10);
    memcpy(v, s->h, sizeof v);
    for (int i = 0; i < 64; i++) {
        uint32_t t = v[7] + (ROTR(v[4], 6) ^ ROTR(v[4], 11) ^ ROTR(v[4], 25)) + ((v[4] & v[5]) ^ (~v[4] & v[6]));
        uint32_t u = (ROTR(v[0], 2) ^ ROTR(v[0], 13) ^ ROTR(v[0], 22));
        t += SHA_K[i] + w[i];
        u += (v[0] & v[1]) ^ (v[0] & v[2]) ^ (v[1] & v[2]);
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
static void SHA_END(struct sha256 *s, uint8_t digest[32])
{
    static const uint8_t pad[64] = {0x80};
    uint64_t bits = 8 * s->length;
    uint8_t tail[8];
    SHA_ADD(s, pad, 1 + (119 - s->length % 64) % 64);
    for (int i = 0; i < 8; i++)
        tail[i] = (uint8_t)(bits >> (56 - 8 * i));
    SHA_ADD(s, tail, 8);
    for (int i = 0; i < 32; i++)
        digest[i] = (uint8_t)(s->h[i / 4] >> (24 - 8 * (i % 4)));
}

/* 9.3: a digest in hexadecimal */
static const char *HEX(const uint8_t digest[32])
{
    static char text[65];
    for (int i = 0; i < 32; i++)
        snprintf(text + 2 * i, 3, "%02x", digest[i]);
    return text;
}

/* ---------------------------------------------------------------- Annex A tables */

struct model { /* 8.4 */
    uint8_t radius;
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
    uint8_t digest[32] = {0};
    SHA_START(&s);
    SHA_ADD(&s, data, length);
    SHA_END(&s, digest);
    if (length != TABLES_LENGTH ||
        strcmp(HEX(digest), "b8b489ae1faadaa4b3c91467cd7517a68c3ac7cda6ee1c5a2c8282dd3ec087b5"))
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
                int radius = data[0];
                m->radius = data[0];
                for (int j = 0; j < 2 * radius + 2; j++)
                    m->frequency[j] = (uint16_t)GET_U16(data + 1 + 2 * j);
                data += 1 + 2 * (2 * radius + 2);
            }
}

/* ---------------------------------------------------------------- 5.1 to 5.6 prologue, header, directory */

/* 6.6: the critical sections, in their order */
enum section { FRAM, WGTS, PLNS, INDX, DATA, CRITICAL, ANCILLARY };

struct entry { /* 5.6; `at` is the offset of the entry */
    uint64_t at, length;
    uint32_t crc;
    enum section section;
    uint8_t type[4], mode;
};

struct list { /* 5.3: some widths of `size` bytes each; `at` is the offset of the first */
    uint64_t at;
    uint8_t count, size;
    uint16_t item[255];
};

/* 5.2 to 5.5: the offsets of the fields that are always at one place */
enum {
    AT_PROFILE = 20,
    AT_LEVEL = 21,
    AT_SECTION_COUNT = 22,
    AT_ANCHOR_COUNT = 24,
    AT_CHUNK_COUNT = 28,
    AT_CHUNK_SIZE = 32,
    AT_LANES = 36,
    AT_RESERVED = 39,
    AT_BASE_STEP = 40,
    AT_ORIGIN = 52,
    AT_SCALE_MANTISSA = 76,
    AT_SCALE_EXPONENT = 78,
    AT_GRID_RESERVED = 79,
    AT_RENDER_INFO = 80,
    AT_UP_AXIS = 83,
    AT_RENDER_NUMBERS = 84, /* near_plane, distance_unit, alpha_max, low_pass */
    AT_RENDER_MODEL = 102,
    AT_RENDER_RESERVED = 103,
    AT_OFFSET_COUNT = 104,
    AT_PLANE_CHANNELS = 105,
    AT_FREQUENCY_COUNT = 106,
    AT_SLICE_COUNT = 107,
    AT_HYPER_LAYERS = 108,
    AT_SARM_LAYERS = 109,
    AT_CARM_LAYERS = 110,
    AT_VIEW_INPUTS = 111,
    AT_COLOUR_OUTPUTS = 112,
    AT_DIMENSIONS_RESERVED = 113,
    AT_PLANE_SIZE = 114,
    AT_RENDER_WIDTH = 116
};

struct header {
    uint32_t minor, length; /* 5.1 */
    uint8_t profile, level;
    uint32_t section_count, anchor_count, chunk_count, chunk_size;
    uint8_t lanes_log2[3]; /* of planes, masks, attributes */
    uint32_t base_step[3];
    int64_t origin[3];
    uint32_t scale_mantissa;
    int scale_exponent;
    uint8_t up_axis, render_model;
    uint32_t render[4]; /* near_plane, distance_unit, alpha_max, low_pass */
    uint8_t offset_count, plane_channels, frequency_count, view_inputs, colour_outputs;
    uint32_t plane_size;
    uint16_t render_width;
    struct list hyper_width, sarm_width, carm_width, slice_width;
    uint8_t *drawn; /* 9.3: the bytes of RenderInfo and of Dimensions; the digest of later fields, if there are any */
    uint64_t drawn_length, later; /* of drawn, and of the fields of a later version */
    struct entry directory[SECTIONS_MAX];
    uint32_t features, channels; /* F and D of 6.3 */
};

/* 5.1, 6.1 */
static void PROLOGUE(struct header *h, struct buffer *b)
{
    static const uint8_t signature[8] = {0x89, 0x43, 0x33, 0x47, 0x53, 0x0D, 0x0A, 0x1A};
    struct piece p = READ(b, PROLOGUE_LENGTH);
    REFUSE_IF(p.length < PROLOGUE_LENGTH, PROLOGUE_TRUNCATED, p.length);
    REFUSE_IF(memcmp(p.data, signature, 8), PROLOGUE_SIGNATURE, 0);
    REFUSE_IF(GET_U32(p.data + 16) != CRC32(0, p.data, 16), PROLOGUE_CRC, 16);
    REFUSE_IF(GET_U16(p.data + 8) != MAJOR, PROLOGUE_VERSION, 8);
    h->minor = GET_U16(p.data + 10);
    h->length = GET_U32(p.data + 12);
    if (h->length < HEADER_LENGTH_MIN || h->length > HEADER_LENGTH_MAX || h->length % 4)
        REFUSE(PROLOGUE_HEADER_LENGTH, 12);
}

/* 5.2: where n more bytes of the header's fields begin. `at` is where the fields before them end. */
static const uint8_t *TAKE(struct piece p, uint64_t *at, uint64_t n)
{
    if (n > p.at + p.length - 4 - *at)
        REFUSE(HEADER_SYNTAX, p.at + p.length); /* the end of the header, with header_crc */
    *at += n;
    return p.data + (*at - n - p.at);
}

/* 5.3: the items of a list whose length is known */
static void TAKE_LIST(struct piece p, uint64_t *at, struct list *l, uint8_t size)
{
    const uint8_t *item;
    l->at = *at;
    l->size = size;
    item = TAKE(p, at, (uint64_t)size * l->count);
    for (uint32_t i = 0; i < l->count; i++)
        l->item[i] = size == 1 ? item[i] : (uint16_t)GET_U16(item + 2 * i);
}

/* 5.2: where the field at an offset of the file is in the array of the fixed fields */
#define FIELD(at) (f + ((at) - PROLOGUE_LENGTH))

/* 5.2 to 5.6, 6.2: R6.2-1 to R6.2-5 */
static void HEADER_FIELDS(struct header *h, struct buffer *b)
{
    struct piece p = READ(b, h->length);
    uint64_t at = PROLOGUE_LENGTH, padding_at, padding;
    uint8_t f[FIXED_LENGTH]; /* as 5.2 to 5.5 have them */
    REFUSE_IF(p.length < h->length, HEADER_TRUNCATED, input_at);
    REFUSE_IF(GET_U32(p.data + p.length - 4) != CRC32(0, p.data, p.length - 4), HEADER_CRC, p.at + p.length - 4);
    memcpy(f, TAKE(p, &at, FIXED_LENGTH), FIXED_LENGTH);
    h->profile = *FIELD(AT_PROFILE);
    h->level = *FIELD(AT_LEVEL);
    h->section_count = GET_U16(FIELD(AT_SECTION_COUNT));
    h->anchor_count = GET_U32(FIELD(AT_ANCHOR_COUNT));
    h->chunk_count = GET_U32(FIELD(AT_CHUNK_COUNT));
    h->chunk_size = GET_U32(FIELD(AT_CHUNK_SIZE));
    memcpy(h->lanes_log2, FIELD(AT_LANES), 3);
    for (int a = 0; a < 3; a++) {
        h->base_step[a] = GET_U32(FIELD(AT_BASE_STEP) + 4 * a);
        h->origin[a] = GET_I64(FIELD(AT_ORIGIN) + 8 * a);
    }
    h->scale_mantissa = GET_U16(FIELD(AT_SCALE_MANTISSA));
    h->scale_exponent = *FIELD(AT_SCALE_EXPONENT) < 128 ? *FIELD(AT_SCALE_EXPONENT) : *FIELD(AT_SCALE_EXPONENT) - 256;
    h->up_axis = *FIELD(AT_UP_AXIS);
    for (int i = 0; i < 4; i++)
        h->render[i] = GET_U32(FIELD(AT_RENDER_NUMBERS) + 4 * i);
    h->render_model = *FIELD(AT_RENDER_MODEL);
    h->offset_count = *FIELD(AT_OFFSET_COUNT);
    h->plane_channels = *FIELD(AT_PLANE_CHANNELS);
    h->frequency_count = *FIELD(AT_FREQUENCY_COUNT);
    h->slice_width.count = *FIELD(AT_SLICE_COUNT);
    h->hyper_width.count = *FIELD(AT_HYPER_LAYERS);
    h->sarm_width.count = *FIELD(AT_SARM_LAYERS);
    h->carm_width.count = *FIELD(AT_CARM_LAYERS);
    h->view_inputs = *FIELD(AT_VIEW_INPUTS);
    h->colour_outputs = *FIELD(AT_COLOUR_OUTPUTS);
    h->plane_size = GET_U16(FIELD(AT_PLANE_SIZE));
    h->render_width = (uint16_t)GET_U16(FIELD(AT_RENDER_WIDTH));
    TAKE_LIST(p, &at, &h->hyper_width, 2);
    TAKE_LIST(p, &at, &h->sarm_width, 2);
    TAKE_LIST(p, &at, &h->carm_width, 2);
    TAKE_LIST(p, &at, &h->slice_width, 1);
    padding_at = at;
    padding = PAD4(at) - at;
    TAKE(p, &at, padding);
    h->drawn_length = at - AT_RENDER_INFO;
    TAKE(p, &at, DIRECTORY_ENTRY_LENGTH * (uint64_t)h->section_count);
    /* A later minor version may have more fields (12.3). */
    REFUSE_IF(at != p.at + p.length - 4 && h->minor <= MINOR, HEADER_SYNTAX, at);
    REFUSE_IF(!ZERO(p, padding_at - p.at, padding_at - p.at + padding), HEADER_PADDING, padding_at);
    REFUSE_IF(*FIELD(AT_RESERVED), HEADER_RESERVED, AT_RESERVED);
    REFUSE_IF(*FIELD(AT_GRID_RESERVED), HEADER_RESERVED, AT_GRID_RESERVED);
    REFUSE_IF(*FIELD(AT_RENDER_RESERVED), HEADER_RESERVED, AT_RENDER_RESERVED);
    REFUSE_IF(*FIELD(AT_DIMENSIONS_RESERVED), HEADER_RESERVED, AT_DIMENSIONS_RESERVED);
    h->later = p.at + p.length - 4 - at;
    h->drawn = ALLOCATE(h->drawn_length + 32, 1);
    memcpy(h->drawn, p.data + (AT_RENDER_INFO - p.at), (size_t)h->drawn_length);
    if (h->later) {
        struct sha256 later;
        SHA_START(&later);
        SHA_ADD(&later, p.data + (at - p.at), h->later);
        SHA_END(&later, h->drawn + h->drawn_length);
        h->drawn_length += 32;
    }
    SURE(h->section_count <= SECTIONS_MAX);
    for (uint32_t i = 0; i < h->section_count; i++) {
        struct entry *e = &h->directory[i];
        uint64_t entry_at = padding_at + padding + DIRECTORY_ENTRY_LENGTH * (uint64_t)i;
        uint8_t d[DIRECTORY_ENTRY_LENGTH];
        memcpy(d, p.data + (entry_at - p.at), sizeof d);
        e->at = entry_at;
        memcpy(e->type, d, 4);
        e->mode = d[4];
        e->length = GET_U64(d + 8);
        e->crc = GET_U32(d + 16);
        REFUSE_IF(d[5] || d[6] || d[7], HEADER_RESERVED, entry_at + 5);
    }
}

struct bounds {
    uint32_t low, high;
};

/* 11.1: one dimension */
static void DIMENSION(uint32_t value, struct bounds b, uint64_t at)
{
    REFUSE_IF(value < b.low || value > b.high, HEADER_DIMENSION, at);
}

/* 11.1: the items of a list */
static void DIMENSION_LIST(const struct list *l, struct bounds b)
{
    for (uint32_t i = 0; i < l->count; i++)
        DIMENSION(l->item[i], b, l->at + i * l->size);
}

/* 11.1, 6.3: the dimensions but for the level's bound; F and D */
static void DIMENSIONS(struct header *h, const struct bounds b[15])
{
    const uint32_t field[11] = {h->offset_count,      h->plane_channels,    h->frequency_count,
                                h->slice_width.count, h->hyper_width.count, h->sarm_width.count,
                                h->carm_width.count,  h->view_inputs,       h->colour_outputs,
                                h->plane_size,        h->render_width};
    static const uint64_t at[11] = {AT_OFFSET_COUNT, AT_PLANE_CHANNELS, AT_FREQUENCY_COUNT,
                                    AT_SLICE_COUNT,  AT_HYPER_LAYERS,   AT_SARM_LAYERS,
                                    AT_CARM_LAYERS,  AT_VIEW_INPUTS,    AT_COLOUR_OUTPUTS,
                                    AT_PLANE_SIZE,   AT_RENDER_WIDTH};
    int planes = h->plane_channels > 0;
    /* plane_size and sarm_layers may be 0 too, as is checked below. */
    for (int i = 0; i < 11; i++)
        if (field[i] || (at[i] != AT_PLANE_SIZE && at[i] != AT_SARM_LAYERS))
            DIMENSION(field[i], b[i], at[i]);
    DIMENSION_LIST(&h->hyper_width, b[11]);
    DIMENSION_LIST(&h->sarm_width, b[12]);
    DIMENSION_LIST(&h->carm_width, b[13]);
    DIMENSION_LIST(&h->slice_width, b[14]);
    h->features = 0;
    for (int i = 0; i < h->slice_width.count; i++)
        h->features += h->slice_width.item[i];
    h->channels = h->features + 6 + 3u * h->offset_count;
    REFUSE_IF(h->features > FEATURES_MAX, HEADER_DIMENSION, h->slice_width.at);
    REFUSE_IF((h->plane_size > 0) != planes, HEADER_DIMENSION, AT_PLANE_SIZE);
    REFUSE_IF((h->sarm_width.count > 0) != planes, HEADER_DIMENSION, AT_SARM_LAYERS);
    REFUSE_IF(!planes && !h->frequency_count && h->hyper_width.count, HEADER_DIMENSION, AT_HYPER_LAYERS);
    REFUSE_IF(h->slice_width.count == 1 && h->carm_width.count, HEADER_DIMENSION, AT_CARM_LAYERS);
    /* 6.5: the render models 0 and 1 restrict these two. */
    REFUSE_IF(!h->render_model && h->view_inputs != 4, HEADER_DIMENSION, AT_VIEW_INPUTS);
    REFUSE_IF(!h->render_model && h->colour_outputs != 3, HEADER_DIMENSION, AT_COLOUR_OUTPUTS);
    REFUSE_IF(h->render_model == STATIC && h->view_inputs, HEADER_DIMENSION, AT_VIEW_INPUTS);
    if (h->render_model == STATIC && h->colour_outputs != 3 && h->colour_outputs != 12 && h->colour_outputs != 27 &&
        h->colour_outputs != 48)
        REFUSE(HEADER_DIMENSION, AT_COLOUR_OUTPUTS);
    SURE(h->offset_count >= 1 && h->offset_count <= OFFSETS_MAX && h->plane_channels <= 16 &&
         h->frequency_count <= 16 && h->slice_width.count >= 1 && h->slice_width.count <= SLICES_MAX &&
         h->view_inputs <= 8 && h->colour_outputs >= 1 && h->colour_outputs <= COLOURS_MAX && h->plane_size <= 1024 &&
         h->render_width <= 128 && h->features <= FEATURES_MAX);
}

/* ---------------------------------------------------------------- 5.8, 7.2 networks */

enum { LAYERS_MAX = 3, WIDTH_MAX = 128, CARM_MAX = SLICES_MAX - 1 };

struct layer {
    uint32_t inputs, outputs;
    int16_t *weight; /* row by row */
    int32_t *bias;
    uint8_t *exponent;
    uint8_t model[LAYER_MODEL_LENGTH]; /* in mode 1, 5.9 */
    uint64_t model_at;                 /* where that is in the section, or 0 in mode 0 */
    uint64_t raw_at;                   /* where its values are in the section, if it is raw in mode 1, or 0 */
};

struct network {
    struct layer layer[LAYERS_MAX]; /* those after the last one have no outputs */
};

enum { HYPER, SARM, CARM_1, OPACITY = CARM_1 + CARM_MAX, COVARIANCE, COLOUR, NETWORKS };

/* 5.8: the number of layers */
static uint32_t LAYERS(const struct network *n)
{
    uint32_t count = 0;
    while (count < LAYERS_MAX && n->layer[count].outputs)
        count++;
    return count;
}

/* 5.8: the shape of one network */
static void SHAPE(struct network *n, uint32_t inputs, const struct list *hidden, uint32_t outputs)
{
    uint32_t count = hidden->count;
    SURE(count < LAYERS_MAX);
    for (uint32_t i = 0; i < count; i++) {
        uint32_t width = hidden->item[i];
        SURE(width <= WIDTH_MAX);
        n->layer[i].inputs = inputs;
        n->layer[i].outputs = inputs = width;
    }
    n->layer[count].inputs = inputs;
    n->layer[count].outputs = outputs;
}

/* 5.8: the shapes of all networks. Networks that are not present have no layers. */
static void SHAPES(const struct header *h, struct network *n)
{
    struct list render = {.count = 1, .item = {h->render_width}};
    uint32_t k = h->offset_count, drawn = h->features + h->view_inputs, inputs = 0;
    SHAPE(&n[HYPER], 2u * h->plane_channels + 2u * h->frequency_count, &h->hyper_width, 2 * h->channels + 3);
    if (h->plane_channels)
        SHAPE(&n[SARM], 4, &h->sarm_width, 2);
    for (uint32_t i = 1; i < h->slice_width.count; i++) {
        inputs += h->slice_width.item[i - 1];
        SHAPE(&n[CARM_1 + i - 1], inputs, &h->carm_width, 2u * h->slice_width.item[i]);
    }
    SHAPE(&n[OPACITY], drawn, &render, k);
    SHAPE(&n[COVARIANCE], drawn, &render, 7 * k);
    SHAPE(&n[COLOUR], drawn, &render, h->colour_outputs * k);
}

/* 5.8, 11.2: the weights and biases of some networks, below 2^20, because of the bounds of 11.1 */
static uint64_t WEIGHT_COUNT(const struct network *n, int first, int end)
{
    uint64_t count = 0;
    for (int i = first; i < end; i++)
        for (uint32_t l = 0; l < LAYERS(&n[i]); l++)
            count += (uint64_t)n[i].layer[l].outputs * (n[i].layer[l].inputs + 1);
    return count;
}

/* 11.2: below 2^46 in a header whose dimensions and anchor_count have passed their checks (7.11) */
static uint64_t WORK(const struct header *h, const struct network *n)
{
    uint64_t anchor = WEIGHT_COUNT(n, HYPER, SARM) + WEIGHT_COUNT(n, CARM_1, OPACITY) + 16 * (uint64_t)h->channels;
    uint64_t points = 5 * (uint64_t)h->plane_channels * h->plane_size * h->plane_size;
    if (!h->view_inputs)
        anchor += WEIGHT_COUNT(n, OPACITY, NETWORKS);
    return h->anchor_count * anchor + points * (WEIGHT_COUNT(n, SARM, CARM_1) + 16);
}

/* 6.5 */
static void RENDER_INFO(const struct header *h)
{
    float x[4];
    REFUSE_IF(h->up_axis > 5, HEADER_RENDER_INFO, AT_UP_AXIS);
    for (uint32_t i = 0; i < 4; i++) {
        x[i] = F32(h->render[i]);
        REFUSE_IF(!IS_FINITE(h->render[i]), HEADER_RENDER_INFO, AT_RENDER_NUMBERS + 4 * i);
    }
    for (uint32_t i = 0; i < 4; i++) /* only alpha_max is bounded above, and only low_pass may be 0 */
        if (!(i == 3 ? x[i] >= 0 : x[i] > 0) || (i == 2 && h->render[i] > ALPHA_LIMIT))
            REFUSE(HEADER_RENDER_INFO, AT_RENDER_NUMBERS + 4 * i);
}

/* 6.2 to 6.5, 11.1, 11.2: the requirements on the header from R6.2-6 on, in the order of their codes; the shapes of the
   networks */
static void HEADER(struct header *h, struct network *networks)
{
    /* offset_count, plane_channels, frequency_count, slice_count, hyper_layers, sarm_layers, carm_layers, view_inputs,
       colour_outputs, plane_size, render_width, hyper_width, sarm_width, carm_width, slice_width, chunk_size */
    static const struct bounds table[2][16] = {
        {{1, 10}, {0, 8}, {0, 10}, {1, 4}, {0, 2}, {1, 2}, {0, 2}, {0, 8}, {1, 48}, {2, 32}, {1, 64}, {1, 64}, {1, 16},
         {1, 64}, {1, 16}, {1, 65536}},
        {{1, OFFSETS_MAX}, {0, 16}, {0, 16}, {1, SLICES_MAX}, {0, 2}, {1, 2}, {0, 2}, {0, 8}, {1, COLOURS_MAX},
         {2, 1024}, {1, 128}, {1, 128}, {1, 32}, {1, 128}, {1, SLICE_WIDTH_MAX}, {256, 16384}}};
    static const struct {
        uint32_t anchor_count, plane_size;
        uint64_t work;
    } levels[6] = {{4096, 32, UINT64_C(1) << 28},
                   {131072, 128, UINT64_C(1) << 33},
                   {1048576, 256, UINT64_C(1) << 36},
                   {4194304, 256, UINT64_C(1) << 38},
                   {16777216, 512, UINT64_C(1) << 41},
                   {67108864, 1024, UINT64_C(1) << 43}};
    /* 11.2: the numbers of Main are multiples of ten */
    uint32_t lowest = h->profile ? 1 : 0, level = h->level / 10;
    struct bounds most;
    uint64_t work;
    REFUSE_IF(h->profile > 1, HEADER_PROFILE, AT_PROFILE);
    REFUSE_IF(h->level % 10 || level < lowest || level > 5 * lowest, HEADER_LEVEL, AT_LEVEL);
    DIMENSIONS(h, table[h->profile]);
    REFUSE_IF(h->plane_size > levels[level].plane_size, HEADER_DIMENSION, AT_PLANE_SIZE);
    REFUSE_IF(h->anchor_count > levels[level].anchor_count, HEADER_ANCHOR_COUNT, AT_ANCHOR_COUNT);
    SHAPES(h, networks);
    work = WORK(h, networks);
    for (uint32_t l = lowest; l < level; l++)
        REFUSE_IF(h->anchor_count <= levels[l].anchor_count && h->plane_size <= levels[l].plane_size &&
                  work <= levels[l].work, HEADER_LEVEL_NOT_MINIMAL, AT_LEVEL);
    most = table[h->profile][15];
    REFUSE_IF(h->chunk_size < most.low || h->chunk_size > most.high, HEADER_CHUNK_SIZE, AT_CHUNK_SIZE);
    for (uint32_t i = 0; i < 3; i++)
        REFUSE_IF(h->lanes_log2[i] > LANES_LOG2_MAX, HEADER_LANES, AT_LANES + i);
    for (uint32_t a = 0; a < 3; a++) {
        float x = F32(h->base_step[a]);
        if (!IS_FINITE(h->base_step[a]) || !(x >= BASE_STEP_MIN && x <= BASE_STEP_MAX))
            REFUSE(HEADER_BASE_STEP, AT_BASE_STEP + 4 * a);
    }
    for (uint32_t a = 0; a < 3; a++)
        if (h->origin[a] <= -ORIGIN_BOUND || h->origin[a] >= ORIGIN_BOUND)
            REFUSE(HEADER_POSITION_GRID, AT_ORIGIN + 8 * a);
    REFUSE_IF(h->scale_mantissa < 1, HEADER_POSITION_GRID, AT_SCALE_MANTISSA);
    if (h->scale_exponent < -SCALE_EXPONENT_MAX || h->scale_exponent > SCALE_EXPONENT_MAX)
        REFUSE(HEADER_POSITION_GRID, AT_SCALE_EXPONENT);
    RENDER_INFO(h);
    REFUSE_IF(work > levels[level].work, HEADER_WORK, AT_ANCHOR_COUNT);
    if (h->chunk_count < (h->anchor_count + h->chunk_size - 1) / h->chunk_size || h->chunk_count > h->anchor_count)
        REFUSE(HEADER_CHUNK_COUNT, AT_CHUNK_COUNT);
}

/* 6.6, 12.1: R6.6-1 to R6.6-5, each over all entries; which section each entry is */
static void DIRECTORY(struct header *h, const struct network *networks)
{
    static const char types[CRITICAL][5] = {"FRAM", "WGTS", "PLNS", "INDX", "DATA"};
    struct entry *d = h->directory;
    uint64_t k = h->offset_count, inputs = h->features - h->slice_width.item[h->slice_width.count - 1];
    int wanted[CRITICAL] = {0}, next = 0, count = 0;
    for (int i = 0; i < CRITICAL; i++)
        if ((i != FRAM || h->plane_channels || h->frequency_count) && (i != PLNS || h->plane_channels))
            wanted[count++] = i;
    for (uint32_t i = 0; i < h->section_count; i++)
        for (int c = 0; c < 4; c++) {
            unsigned letter = d[i].type[c] & ~32u;
            REFUSE_IF(letter < 'A' || letter > 'Z', DIRECTORY_TYPE, d[i].at);
        }
    for (uint32_t i = 0; i < h->section_count; i++) {
        int section = d[i].type[0] & 32 ? ANCILLARY : 0;
        while (section < CRITICAL && memcmp(d[i].type, types[section], 4))
            section++;
        REFUSE_IF(section == CRITICAL, DIRECTORY_UNKNOWN_CRITICAL, d[i].at);
        d[i].section = (enum section)section;
    }
    for (uint32_t i = 0; i < h->section_count; i++)
        if (d[i].section != ANCILLARY && (next >= count || wanted[next++] != (int)d[i].section))
            REFUSE(DIRECTORY_ORDER, d[i].at);
    REFUSE_IF(next < count, DIRECTORY_ORDER, AT_SECTION_COUNT);
    for (uint32_t i = 0; i < h->section_count; i++)
        if (d[i].section != ANCILLARY && d[i].mode > (d[i].section == WGTS || d[i].section == INDX))
            REFUSE(DIRECTORY_MODE, d[i].at + 4);
    for (uint32_t i = 0; i < h->section_count; i++) {
        uint64_t expected = d[i].length;
        if (d[i].section == FRAM)
            expected = FRAME_LENGTH;
        if (d[i].section == WGTS && !d[i].mode)
            expected = PAD4(2 + inputs) + 4 * WEIGHT_COUNT(networks, 0, NETWORKS);
        if (d[i].section == INDX)
            expected = PAD4(k * (k + 1)) + POSITION_MODEL_LENGTH * (uint64_t)d[i].mode +
                       CHUNK_ENTRY_LENGTH * (uint64_t)h->chunk_count;
        REFUSE_IF(d[i].length != expected || d[i].length > SECTION_LENGTH_MAX, DIRECTORY_LENGTH, d[i].at + 8);
    }
}

/* 6.6: R6.6-6 to R6.6-8 of any section but DATA. The result has no padding. */
static struct piece SECTION(const struct entry *e, struct buffer *b)
{
    struct piece p = READ(b, PAD4(e->length));
    REFUSE_IF(p.length < PAD4(e->length), SECTION_TRUNCATED, input_at);
    REFUSE_IF(CRC32(0, p.data, e->length) != e->crc, SECTION_CRC, p.at);
    REFUSE_IF(!ZERO(p, e->length, p.length), SECTION_PADDING, p.at + e->length);
    p.length = e->length;
    return p;
}

/* 12.1, 6.6: the same of an ancillary section, of which little is held at a time */
static void SKIP_SECTION(const struct entry *e, struct buffer *b)
{
    uint64_t start = input_at, rest = e->length;
    uint32_t crc = 0;
    struct piece p;
    while (rest) {
        p = READ(b, rest < 1 << 16 ? rest : 1 << 16);
        REFUSE_IF(!p.length, SECTION_TRUNCATED, input_at);
        crc = CRC32(crc, p.data, p.length);
        rest -= p.length;
    }
    p = READ(b, PAD4(e->length) - e->length);
    REFUSE_IF(p.length < PAD4(e->length) - e->length, SECTION_TRUNCATED, input_at);
    REFUSE_IF(crc != e->crc, SECTION_CRC, start);
    REFUSE_IF(!ZERO(p, 0, p.length), SECTION_PADDING, p.at);
}

/* ---------------------------------------------------------------- 7.2 integer networks */

/* 7.2: derives one row. The result is 0 if no exponent will do. */
static int DERIVE_ROW(const uint8_t *weights, uint32_t bias, struct layer *l, uint32_t row)
{
    for (int e = EXPONENT_MAX; e >= 0; e--) {
        int64_t b = ROUND_SCALED(bias, e); /* |b| < 2^54 */
        uint64_t sum = 0;                  /* below 2^8 * 2^10 */
        uint32_t i;
        for (i = 0; i < l->inputs; i++) {
            int64_t w = ROUND_SCALED(GET_U32(weights + 4 * i), e);
            if (MAGNITUDE(w) > WEIGHT_MAX)
                break;
            sum += (uint64_t)MAGNITUDE(w);
            l->weight[row * l->inputs + i] = (int16_t)w;
        }
        sum = sum * ACTIVATION_MAX + (uint64_t)MAGNITUDE(b) + ((UINT64_C(1) << e) >> 1);
        if (i == l->inputs && sum < ACCUMULATOR_BOUND) {
            l->bias[row] = (int32_t)b;
            l->exponent[row] = (uint8_t)e;
            return 1;
        }
    }
    return 0;
}

/* 6.8: R6.8-4 of the networks before `end`, for finite values. p is the section, whose values in mode 0 are at
   values_at of it. */
static void DERIVE_NETWORKS(struct network *n, int end, const uint8_t *values, struct piece p, uint64_t values_at)
{
    uint64_t v = 0;
    for (int i = 0; i < end; i++)
        for (uint32_t k = 0; k < LAYERS(&n[i]); k++) {
            struct layer *l = &n[i].layer[k];
            uint64_t biases = v + 4 * (uint64_t)l->outputs * l->inputs;
            l->weight = ALLOCATE((uint64_t)l->outputs * l->inputs, sizeof *l->weight);
            l->bias = ALLOCATE(l->outputs, sizeof *l->bias);
            l->exponent = ALLOCATE(l->outputs, 1);
            for (uint32_t r = 0; r < l->outputs; r++) {
                uint64_t row = v + 4 * (uint64_t)r * l->inputs;
                uint64_t named = l->inputs ? row : biases + 4 * (uint64_t)r; /* a row without weights has its bias */
                if (!DERIVE_ROW(values + row, GET_U32(values + biases + 4 * r), l, r))
                    REFUSE(WEIGHTS_BOUND, p.at + (l->model_at ? l->model_at : values_at + named));
            }
            v = biases + 4 * (uint64_t)l->outputs;
        }
}

/* 7.2 */
static int32_t ACTIVATION(int64_t a) { return (int32_t)CLAMP(a, -ACTIVATION_MAX, ACTIVATION_MAX); }

/* 7.2: accumulators stay below ACCUMULATOR_BOUND, so 32 bits hold them */
static void NETWORK(const struct network *n, const int32_t *inputs, int32_t *outputs)
{
    int32_t a[2][WIDTH_MAX]; /* of hidden layers */
    uint32_t layers = LAYERS(n);
    for (uint32_t k = 0; k < layers; k++) {
        const struct layer *l = &n->layer[k];
        int last = k + 1 == layers;
        int32_t *out = last ? outputs : a[k & 1];
        for (uint32_t r = 0; r < l->outputs; r++) {
            const int16_t *w = l->weight + r * l->inputs;
            int32_t sum = l->bias[r];
            uint8_t exponent = l->exponent[r];
            for (uint32_t i = 0; i < l->inputs; i++)
                sum += w[i] * inputs[i];
            SURE(sum > -ACCUMULATOR_BOUND && sum < ACCUMULATOR_BOUND && exponent <= EXPONENT_MAX);
            sum = (int32_t)RSHIFT_ROUND(sum, exponent);
            out[r] = last ? sum : (int32_t)CLAMP(sum, 0, ACTIVATION_MAX);
        }
        if (last)
            return;
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

/* 8.1, 5.15 */
static void OPEN(struct stream *s, struct piece p, unsigned lanes_log2)
{
    uint32_t lanes = UINT32_C(1) << (lanes_log2 & 15); /* LANES_LOG2_MAX at most */
    uint64_t words_at = 8 + 4 * (uint64_t)lanes, raw_at;
    SURE(lanes <= LANES_MAX);
    REFUSE_IF(p.length < words_at, SUBSTREAM_LENGTH, p.at);
    memset(s, 0, sizeof *s);
    s->at = p.at;
    s->lanes = lanes;
    s->expected_crc = GET_U32(p.data);
    s->word_count = GET_U32(p.data + 4);
    raw_at = words_at + 2 * (uint64_t)s->word_count;
    REFUSE_IF(p.length < raw_at, SUBSTREAM_LENGTH, p.at);
    for (uint32_t n = 0; n < lanes; n++) {
        s->state[n] = GET_U32(p.data + 8 + 4 * n);
        REFUSE_IF(s->state[n] < STATE_MIN, SUBSTREAM_STATE, p.at);
    }
    s->words = p.data + words_at;
    s->raw = p.data + raw_at;
    s->raw_length = p.length - raw_at;
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

/* 8.5: |mean| and |scale| are below 2^25, because they are sums of two numbers below ACCUMULATOR_BOUND. */
enum { NUMBER_BOUND = 2 * ACCUMULATOR_BOUND };
static const struct model *SELECT(family f, int32_t mean, int32_t scale, int32_t *centre, unsigned *raw_bits)
{
    unsigned k;
    int32_t row, h;
    SURE(mean > -NUMBER_BOUND && mean < NUMBER_BOUND && scale > -NUMBER_BOUND && scale < NUMBER_BOUND);
    k = (unsigned)CLAMP(RSHIFT(scale - 24, 3) + 1, 0, RAW_MAX);
    row = (int32_t)CLAMP(scale - 8 * (int32_t)k, SCALE_MIN, SCALE_END - 1);
    h = (int32_t)RSHIFT_ROUND(mean - 8 * ((INT32_C(1) << k) - 1), k) + 8;
    *centre = (int32_t)RSHIFT(h, 4);
    *raw_bits = k;
    return &f[row - SCALE_MIN][h & 15];
}

/* 8.6, 8.7: for k <= ESCAPE_PREFIX_MAX */
static uint32_t READ_BITS(struct stream *s, unsigned k)
{
    uint32_t value = 0;
    for (unsigned i = 0; i < k; i++, s->raw_at++)
        if (s->raw_at >> 3 < s->raw_length)
            value |= (uint32_t)(s->raw[s->raw_at >> 3] >> (s->raw_at & 7) & 1) << i;
    return value;
}

/* 8.7: the distance from the centre, which is below 2^24 + 2^8 in magnitude */
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
    SURE(n > 0 && n < 1 << (ESCAPE_PREFIX_MAX + 1));
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
    for (uint64_t i = 0; i < count; i++) {
        const struct model *m = SELECT(f, v[i].mean, v[i].scale, &centre, &k);
        v[i].symbol = (uint8_t)DECODE_SYMBOL(s, (uint32_t)(i % s->lanes), m->frequency);
    }
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
    REFUSE_IF(s->word_at != s->word_count, SUBSTREAM_WORDS, s->at);
    for (uint32_t n = 0; n < s->lanes; n++)
        REFUSE_IF(s->state[n] != STATE_MIN, SUBSTREAM_FINAL_STATE, s->at);
    REFUSE_IF(s->bad_escape, SUBSTREAM_ESCAPE, s->at);
    REFUSE_IF(s->bad_range, SUBSTREAM_SYMBOL_RANGE, s->at);
    REFUSE_IF(s->raw_length != (s->raw_at + 7) / 8, SUBSTREAM_RAW_LENGTH, s->at);
    REFUSE_IF(s->raw_at % 8 && s->raw[s->raw_length - 1] >> (s->raw_at % 8), SUBSTREAM_RAW_PADDING, s->at);
    REFUSE_IF(s->symbol_crc != s->expected_crc, SUBSTREAM_SYMBOL_CRC, s->at);
}

/* ---------------------------------------------------------------- 9.3 the canonical reconstruction */

/* SPLATS, the part splat, is of static scenes only. */
enum { POSITIONS, MASKS, PLANES, FEATURES, SCALINGS, OFFSETS, WEIGHTS, SPLATS, PARTS, HEAD_LENGTH = 12 };

struct part {
    struct sha256 digest;
    uint64_t at; /* where its next bytes are in OUTPUT */
};

/* 9.3: adds the next bytes of a part */
static void EMIT(struct part *p, const uint8_t *data, uint64_t n)
{
    SHA_ADD(&p->digest, data, n);
    if (output && (p->at > LONG_MAX || fseek(output, (long)p->at, SEEK_SET) || fwrite(data, 1, (size_t)n, output) != n))
        FAIL("cannot write");
    p->at += n;
}

/* ---------------------------------------------------------------- probes, not of the specification */

enum { PROBES_MAX = 16 << 20, PROBE_NUMBER = 21, PROBE_HEAD = 64 };

/* Whether a probe of so many numbers is written, and its name. `slice` is that of NAME, or negative. */
static int PROBE_BEGIN(const char *name, int slice, const char *kind, uint64_t anchor, uint64_t count)
{
    if (!probes || count > PROBES_MAX / PROBE_NUMBER)
        return 0;
    probed += PROBE_HEAD + PROBE_NUMBER * count;
    if (probed > PROBES_MAX) {
        probed = PROBES_MAX; /* no later one is written */
        return 0;
    }
    if (slice < 0)
        fprintf(probes, "probe %s[%llu]", name, (unsigned long long)anchor);
    else
        fprintf(probes, "probe %s.%d.%s[%llu]", name, slice, kind, (unsigned long long)anchor);
    return 1;
}

static void PROBE(const char *name, uint64_t anchor, const int32_t *numbers, uint64_t count)
{
    if (!PROBE_BEGIN(name, -1, "", anchor, count))
        return;
    for (uint64_t i = 0; i < count; i++)
        fprintf(probes, " %ld", (long)numbers[i]);
    putc('\n', probes);
}

static void PROBE_POINT(const char *name, uint64_t anchor, const int64_t numbers[3])
{
    if (PROBE_BEGIN(name, -1, "", anchor, 3))
        fprintf(probes, " %lld %lld %lld\n", (long long)numbers[0], (long long)numbers[1], (long long)numbers[2]);
}

/* the sums of the numbers of F_h and of CARM */
static void PROBE_SLICE(int slice, const char *kind, uint64_t anchor, const int32_t *own, const int32_t *change,
                        uint64_t count)
{
    if (!PROBE_BEGIN("slice", slice, kind, anchor, count))
        return;
    for (uint64_t i = 0; i < count; i++)
        fprintf(probes, " %lld", (long long)own[i] + change[i]);
    putc('\n', probes);
}

/* ---------------------------------------------------------------- the scene */

struct frame { /* 5.7 */
    int64_t matrix[9], translation[3], low[3], high[3];
    unsigned shift[3];
};

struct scene {
    struct header h;
    struct buffer section, index; /* bytes of a section or a chunk; those of INDX stay */
    struct frame frame;
    struct network networks[NETWORKS];
    unsigned plane_shift;
    uint8_t carm_shift[FEATURES_MAX];
    int16_t *plane[5]; /* the sub-planes, [channel][i][j] */
    int16_t *plane_2;  /* the plane of r = 2 */
    uint32_t mask_model[OFFSETS_MAX * (OFFSETS_MAX + 1) / 2];
    int packed; /* the mode of INDX */
    unsigned cell_shift; /* 5.12 */
    uint16_t position_model[POSITION_MODELS][16];
    const uint8_t *entries; /* of type ChunkEntry, 5.13 */
    uint32_t largest;       /* anchors of the largest chunk */
    struct part part[PARTS];

    /* of the chunk that is decoded */
    uint64_t first_anchor; /* for probes */
    uint16_t *position_bits; /* three f16 of each anchor */
    uint16_t (*nodes)[3], (*next_nodes)[3];
    uint8_t *halves; /* of the nodes, the first symbols */
    uint8_t *masks;  /* K bits of each anchor, a byte each */
    int32_t *parameters, *change, *symbols; /* outputs of F_h, outputs of CARM, D symbols, of each anchor */
    struct value *group;
    uint8_t *values; /* of one part */
    uint8_t *step_index; /* three of each anchor */
    uint32_t step[3][STEP_LENGTH]; /* 9.2: the f32 of each kind and index */
};

/* 5.7, 6.7: the section has its length */
static void FRAME(struct scene *s, struct piece p)
{
    struct frame *f = &s->frame;
    uint8_t d[FRAME_LENGTH];
    memcpy(d, p.data, sizeof d);
    REFUSE_IF(d[63], FRAME_RESERVED, p.at + 63);
    for (uint32_t i = 0; i < 9; i++) {
        int64_t v = GET_I32(d + 4 * i);
        REFUSE_IF(v <= -MATRIX_BOUND || v >= MATRIX_BOUND, FRAME_RANGE, p.at + 4 * i);
        f->matrix[i] = v;
    }
    for (uint32_t i = 0; i < 3; i++) {
        int64_t v = GET_I64(d + 36 + 8 * i);
        REFUSE_IF(v <= -TRANSLATION_BOUND || v >= TRANSLATION_BOUND, FRAME_RANGE, p.at + 36 + 8 * i);
        f->translation[i] = v;
    }
    for (uint32_t i = 0; i < 3; i++) {
        unsigned v = d[60 + i];
        REFUSE_IF(v > FRAME_SHIFT_MAX, FRAME_RANGE, p.at + 60 + i);
        f->shift[i] = v;
    }
    for (uint32_t i = 0; i < 3; i++) {
        int64_t low = GET_I32(d + 64 + 4 * i), high = GET_I32(d + 76 + 4 * i);
        REFUSE_IF(low < -FRAME_RANGE_BOUND || low >= FRAME_RANGE_BOUND, FRAME_RANGE, p.at + 64 + 4 * i);
        REFUSE_IF(high <= low || high > FRAME_RANGE_BOUND, FRAME_RANGE, p.at + 76 + 4 * i);
        f->low[i] = low;
        f->high[i] = high;
    }
}

/* ---------------------------------------------------------------- 5.8, 5.9, 7.13 weights */

/* 5.9, 6.8: R6.8-5 to R6.8-7 of all layers, whose first LayerModel is at `at` of the section. The result is where the
   substream begins. */
static uint64_t LAYER_MODELS(struct scene *s, struct piece p, uint64_t at)
{
    for (int i = 0; i < NETWORKS; i++)
        for (uint32_t k = 0; k < LAYERS(&s->networks[i]); k++) {
            struct layer *l = &s->networks[i].layer[k];
            const uint8_t *m = l->model;
            uint64_t bytes = 4 * (uint64_t)l->outputs * (l->inputs + 1);
            int64_t exponent;
            REFUSE_IF(LAYER_MODEL_LENGTH > p.length - at, WEIGHTS_LENGTH, p.at);
            memcpy(l->model, p.data + at, sizeof l->model);
            l->model_at = at;
            REFUSE_IF(m[6] || m[7], WEIGHTS_RESERVED, p.at + at + 6);
            REFUSE_IF(m[0] > 1, WEIGHTS_LAYER, p.at + at);
            exponent = GET_I16(m + 2);
            REFUSE_IF(exponent < WEIGHT_EXPONENT_MIN || exponent > WEIGHT_EXPONENT_MAX, WEIGHTS_LAYER, p.at + at + 2);
            if (!m[0]) { /* a raw one: exponent_scale, exponent, weight_scale, bias_scale are 0 */
                REFUSE_IF(m[1], WEIGHTS_LAYER, p.at + at + 1);
                REFUSE_IF(exponent, WEIGHTS_LAYER, p.at + at + 2);
                REFUSE_IF(m[4], WEIGHTS_LAYER, p.at + at + 4);
                REFUSE_IF(m[5], WEIGHTS_LAYER, p.at + at + 5);
            }
            at += LAYER_MODEL_LENGTH;
            if (!m[0]) {
                REFUSE_IF(bytes > p.length - at, WEIGHTS_LENGTH, p.at);
                l->raw_at = at;
                at += bytes;
            }
        }
    return at;
}

/* 7.13: the bits of n * 2^-e, exactly, for |n| < 2^24 and the exponent e of a row */
static uint32_t ON_GRID(int32_t n, int64_t e)
{
    uint32_t m = (uint32_t)MAGNITUDE(n), sign = n < 0 ? UINT32_C(1) << 31 : 0;
    int zeros = 0;
    if (!m)
        return 0;
    while (zeros < 23 && !(m << zeros & 0x800000))
        zeros++;
    m <<= zeros;
    e += zeros;
    if (e >= 150)
        return sign | m >> (e - 149);
    return sign | (uint32_t)(150 - e) << 23 | (m & 0x7FFFFF);
}

/* 7.13, 6.8: writes the values of one layer to v, R6.8-8. few has its differences and its biases, many its weights. */
static void PACKED_LAYER(struct piece p, const struct layer *l, const struct value *few, const struct value *many,
                         uint8_t *v)
{
    uint64_t at = p.at + l->model_at, rows = l->outputs, inputs = l->inputs;
    int64_t e = GET_I16(l->model + 2);
    int first = 1;
    for (uint64_t r = 0; r < rows; r++) {
        int32_t difference = few[r].value, bias = few[rows + r].value;
        uint32_t any = (uint32_t)MAGNITUDE(bias);
        e += difference;
        for (uint64_t i = 0; i < inputs; i++)
            any |= (uint32_t)MAGNITUDE(many[r * inputs + i].value);
        REFUSE_IF(e < WEIGHT_EXPONENT_MIN || e > WEIGHT_EXPONENT_MAX || (any && !(any & 1)) ||
                  (difference && (!any || first)), WEIGHTS_EXPONENT, at);
        first = first && !any;
        for (uint64_t i = 0; i < inputs; i++)
            PUT_U32(v + 4 * (r * inputs + i), ON_GRID(many[r * inputs + i].value, e));
        PUT_U32(v + 4 * (rows * inputs + r), ON_GRID(bias, e));
    }
    REFUSE_IF(first && GET_I16(l->model + 2), WEIGHTS_EXPONENT, at);
}

/* 6.8: R6.8-3, of values at `at` of the section */
static void CHECK_FINITE(struct piece p, uint64_t at, uint64_t count)
{
    for (uint64_t n = 0; n < count; n++)
        REFUSE_IF(!IS_FINITE(GET_U32(p.data + at + 4 * n)), WEIGHTS_NOT_FINITE, p.at + at + 4 * n);
}

/* 7.13, 6.8: writes the values in mode 1 to v. The first LayerModel is at `at` of the section. */
static void DECODE_WEIGHTS(struct scene *s, struct piece p, uint64_t at, uint8_t *v)
{
    struct value *few, *many, *few_values, *many_values;
    uint64_t few_count = 0, many_count = 0;
    struct stream stream;
    at = LAYER_MODELS(s, p, at);
    for (int i = 0; i < NETWORKS; i++)
        for (uint32_t k = 0; k < LAYERS(&s->networks[i]); k++) {
            const struct layer *l = &s->networks[i].layer[k];
            few_count += l->raw_at ? 0 : 2 * l->outputs;
            many_count += l->raw_at ? 0 : (uint64_t)l->outputs * l->inputs;
        }
    few = few_values = ALLOCATE(few_count, sizeof *few);
    many = many_values = ALLOCATE(many_count, sizeof *many);
    OPEN(&stream, CUT(p, at, p.length - at), s->h.lanes_log2[2]);
    few_count = many_count = 0;
    for (int i = 0; i < NETWORKS; i++)
        for (uint32_t k = 0; k < LAYERS(&s->networks[i]); k++) {
            const struct layer *l = &s->networks[i].layer[k];
            if (l->raw_at)
                continue;
            for (uint32_t r = 0; r < 2 * l->outputs; r++)
                few[few_count++].scale = SCALE_MIN + l->model[r < l->outputs ? 1 : 5];
            for (uint64_t n = 0; n < (uint64_t)l->outputs * l->inputs; n++)
                many[many_count++].scale = SCALE_MIN + l->model[4];
        }
    DECODE_VALUES(&stream, LAPLACE, few, few_count, WEIGHT_SYMBOL_MAX);
    DECODE_VALUES(&stream, GAUSS, many, many_count, WEIGHT_SYMBOL_MAX);
    END(&stream);
    for (int i = 0; i < NETWORKS; i++)
        for (uint32_t k = 0; k < LAYERS(&s->networks[i]); k++) {
            const struct layer *l = &s->networks[i].layer[k];
            uint64_t weights = (uint64_t)l->outputs * l->inputs, count = weights + l->outputs;
            if (l->raw_at) {
                CHECK_FINITE(p, l->raw_at, count);
                memcpy(v, p.data + l->raw_at, (size_t)(4 * count));
            } else {
                PACKED_LAYER(p, l, few, many, v);
                few += 2 * l->outputs;
                many += weights;
            }
            v += 4 * count;
        }
    FREE(few_values);
    FREE(many_values);
}

/* 5.8, 6.8: in mode 0 the section is known to have the length of R6.6-5 */
static void READ_WEIGHTS(struct scene *s, struct piece p, int mode)
{
    uint32_t inputs = s->h.features - s->h.slice_width.item[s->h.slice_width.count - 1];
    uint64_t values_at = PAD4(2 + inputs), count = WEIGHT_COUNT(s->networks, 0, NETWORKS);
    uint8_t *values = NULL;
    SURE(inputs < FEATURES_MAX);
    REFUSE_IF(p.length < values_at, WEIGHTS_LENGTH, p.at);
    s->plane_shift = p.data[0];
    REFUSE_IF(s->plane_shift > (s->h.plane_channels ? PLANE_SHIFT_MAX : 0), WEIGHTS_SCALE, p.at);
    REFUSE_IF(p.data[1] != inputs, WEIGHTS_SCALE, p.at + 1);
    for (uint32_t i = 0; i < inputs; i++) {
        s->carm_shift[i] = p.data[2 + i];
        REFUSE_IF(s->carm_shift[i] > CARM_SHIFT_MAX, WEIGHTS_SCALE, p.at + 2 + i);
    }
    REFUSE_IF(!ZERO(p, 2 + inputs, values_at), WEIGHTS_PADDING, p.at + 2 + inputs);
    if (mode) {
        values = ALLOCATE(count, 4);
        DECODE_WEIGHTS(s, p, values_at, values);
    } else
        CHECK_FINITE(p, values_at, count);
    DERIVE_NETWORKS(s->networks, s->h.render_model == STATIC ? NETWORKS : OPACITY,
                    mode ? values : p.data + values_at, p, values_at);
    EMIT(&s->part[WEIGHTS], mode ? values : p.data + values_at, 4 * count);
    if (mode)
        FREE(values);
}

/* ---------------------------------------------------------------- 7.3 planes */

/* 7.3: a symbol of a channel of a sub-plane, or 0 outside the sub-plane */
static int32_t AT(const int16_t *y, int32_t size, int32_t i, int32_t j)
{
    return i >= 0 && i < size && j >= 0 && j < size ? y[i * size + j] : 0;
}

/* 7.3: the groups are the wavefronts. Their points are in the order of channels, then of rows. */
static void DECODE_PLANE(struct stream *stream, const struct network *sarm, int32_t channels, int32_t size,
                         int16_t *plane, struct value *group)
{
    for (int32_t t = 0; t < 3 * size - 2; t++) {
        /* the rows with 0 <= t - 2 i < size */
        int32_t first = t < size ? 0 : (t - size + 2) / 2, last = t / 2 < size ? t / 2 : size - 1;
        uint64_t count = 0;
        for (int32_t k = 0; k < channels; k++)
            for (int32_t i = first; i <= last; i++) {
                const int16_t *y = plane + k * size * size;
                int32_t j = t - 2 * i, out[2] = {0};
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

/* 5.10, 6.9, 9.3 */
static void READ_PLANES(struct scene *s, struct piece p)
{
    uint64_t sum = PLANE_TABLE_LENGTH, at = PLANE_TABLE_LENGTH, length[5], points;
    int32_t size = (int32_t)s->h.plane_size, channels = s->h.plane_channels;
    struct stream stream;
    struct value *group;
    uint8_t *bytes;
    REFUSE_IF(p.length < PLANE_TABLE_LENGTH, PLANES_LENGTH, p.at);
    for (int i = 0; i < 5; i++)
        sum += PAD4(length[i] = GET_U32(p.data + 4 * i));
    REFUSE_IF(sum != p.length, PLANES_LENGTH, p.at);
    for (int i = 0; i < 5; at += PAD4(length[i]), i++)
        REFUSE_IF(!ZERO(p, at + length[i], at + PAD4(length[i])), PLANES_PADDING, p.at + at + length[i]);
    points = (uint64_t)channels * s->h.plane_size * s->h.plane_size;
    group = ALLOCATE((uint64_t)(channels * size), sizeof *group);
    bytes = ALLOCATE(points, 2);
    at = PLANE_TABLE_LENGTH;
    for (int i = 0; i < 5; at += PAD4(length[i]), i++) {
        s->plane[i] = ALLOCATE(points, sizeof **s->plane);
        OPEN(&stream, CUT(p, at, length[i]), s->h.lanes_log2[0]);
        DECODE_PLANE(&stream, &s->networks[SARM], channels, size, s->plane[i], group);
        END(&stream);
        for (uint64_t n = 0; n < points; n++)
            PUT_U16(bytes + 2 * n, (uint16_t)s->plane[i][n]);
        EMIT(&s->part[PLANES], bytes, 2 * points);
    }
    FREE(group);
    FREE(bytes);
}

/* 7.5: the plane of r = 2 from its four sub-planes */
static void JOIN_QUADRANTS(struct scene *s)
{
    int32_t b = (int32_t)s->h.plane_size, channels = s->h.plane_channels;
    s->plane_2 = ALLOCATE((uint64_t)(channels * 4 * b * b), sizeof *s->plane_2);
    for (int32_t k = 0; k < channels; k++)
        for (int32_t i = 0; i < 2 * b; i++)
            for (int32_t j = 0; j < 2 * b; j++) {
                const int16_t *quadrant = s->plane[1 + 2 * (i >= b) + (j >= b)];
                s->plane_2[(k * 2 * b + i) * 2 * b + j] = quadrant[(k * b + i % b) * b + j % b];
            }
}

/* ---------------------------------------------------------------- 5.11 to 5.13, 6.10 index */

struct chunk { /* 5.13 */
    uint64_t length;
    uint32_t crc, anchors, kept;
    uint32_t low[3], high[3];
};

/* 5.13 */
static void ENTRY(const uint8_t *entries, uint64_t number, struct chunk *c)
{
    uint8_t e[CHUNK_ENTRY_LENGTH];
    memcpy(e, entries + CHUNK_ENTRY_LENGTH * number, sizeof e);
    c->length = GET_U32(e);
    c->crc = GET_U32(e + 4);
    c->anchors = GET_U32(e + 8);
    c->kept = GET_U32(e + 12);
    for (int a = 0; a < 3; a++) {
        c->low[a] = GET_U16(e + 16 + 2 * a);
        c->high[a] = GET_U16(e + 22 + 2 * a);
    }
}

/* 6.10: an integer that orders f16 as their numbers are */
static int32_t F16_ORDER(uint32_t bits) { return bits >> 15 ? -(int32_t)(bits & 0x7FFF) : (int32_t)bits; }

/* 5.12, 6.10: R6.10-3, R6.10-4, of a model at `at` of the section */
static void POSITION_MODEL(struct scene *s, struct piece p, uint64_t at)
{
    REFUSE_IF(!ZERO(p, at + 1, at + 4), INDEX_RESERVED, p.at + at + 1);
    s->cell_shift = p.data[at];
    REFUSE_IF(s->cell_shift > CELL_INDEX, INDEX_POSITION_MODEL, p.at + at);
    for (uint64_t m = 0; m < POSITION_MODELS; m++) {
        uint32_t sum = 0, right = 1;
        for (uint64_t i = 0; i < 16; i++) {
            uint32_t f = GET_U16(p.data + at + 4 + 32 * m + 2 * i);
            sum += f;
            right &= (f == 0) == (i == 0 && m % 6 == 1);
            s->position_model[m][i] = (uint16_t)f;
        }
        REFUSE_IF(!right || sum != 1 << PRECISION, INDEX_POSITION_MODEL, p.at + at + 4 + 32 * m);
    }
}

/* 6.10: R6.10-5, of an entry whose offset is `at` */
static void CHECK_ENTRY(const struct scene *s, const struct chunk *c, uint64_t at)
{
    REFUSE_IF(c->anchors < 1 || c->anchors > s->h.chunk_size, INDEX_CHUNK, at + 8);
    REFUSE_IF(c->length % 4 || c->length < CHUNK_HEAD_LENGTH ||
              ANCHORS_OF_A_BYTE * (c->length - CHUNK_HEAD_LENGTH) < c->anchors, INDEX_CHUNK, at);
    REFUSE_IF(c->kept > (uint64_t)s->h.offset_count * c->anchors, INDEX_CHUNK, at + 12);
    for (uint32_t i = 0; i < 6; i++) {
        uint32_t bits = i < 3 ? c->low[i] : c->high[i - 3];
        REFUSE_IF((bits & 0x7C00) == 0x7C00 || bits == 0x8000, INDEX_CHUNK, at + 16 + 2 * i);
    }
    for (uint32_t a = 0; a < 3; a++)
        REFUSE_IF(F16_ORDER(c->low[a]) > F16_ORDER(c->high[a]), INDEX_CHUNK, at + 16 + 2 * a);
}

/* 5.11, 6.10: the section is known to have the length of R6.6-5. data_length is the length of DATA. */
static void READ_INDEX(struct scene *s, struct piece p, int mode, uint64_t data_length)
{
    uint32_t numbers = s->h.offset_count * (s->h.offset_count + 1u) / 2;
    uint64_t at = PAD4(2 * numbers), anchors = 0, bytes = 0;
    struct chunk c;
    for (uint32_t i = 0; i < numbers; i++) {
        s->mask_model[i] = GET_U16(p.data + 2 * i);
        REFUSE_IF(s->mask_model[i] < 1 || s->mask_model[i] > (1 << PRECISION) - 1, INDEX_MASK_MODEL, p.at + 2 * i);
    }
    REFUSE_IF(!ZERO(p, 2 * numbers, at), INDEX_PADDING, p.at + 2 * numbers);
    s->packed = mode;
    if (mode) {
        POSITION_MODEL(s, p, at);
        at += POSITION_MODEL_LENGTH;
    }
    s->entries = p.data + at;
    for (uint32_t i = 0; i < s->h.chunk_count; i++) {
        ENTRY(s->entries, i, &c);
        CHECK_ENTRY(s, &c, p.at + at + CHUNK_ENTRY_LENGTH * (uint64_t)i);
        anchors += c.anchors;
        bytes += c.length; /* below 2^26 * 2^32 */
        s->largest = s->largest < c.anchors ? c.anchors : s->largest;
    }
    REFUSE_IF(anchors != s->h.anchor_count || bytes != data_length, INDEX_LENGTH, p.at);
}

/* ---------------------------------------------------------------- 7.4, 7.5 positions and geometry to context */

/* 7.4: |P| < 2^40 */
static int64_t POSITION_INTEGER(uint32_t bits)
{
    uint32_t exponent = bits >> 10 & 31, mantissa = bits & 1023;
    int64_t p;
    SURE(exponent < 31);
    p = exponent ? (int64_t)(mantissa + 1024) << (exponent - 1) : (int64_t)mantissa;
    return bits >> 15 ? -p : p;
}

/* 6.11: R6.11-6, R6.11-7; reads the positions of a chunk in form 0 */
static void RAW_POSITIONS(struct scene *s, struct piece p)
{
    for (uint64_t i = 0; i < p.length / 2; i++) {
        uint32_t bits = GET_U16(p.data + 2 * i);
        REFUSE_IF((bits & 0x7C00) == 0x7C00, POSITIONS_NOT_FINITE, p.at + 2 * i);
        REFUSE_IF(bits == 0x8000, POSITIONS_NEGATIVE_ZERO, p.at + 2 * i);
        s->position_bits[i] = (uint16_t)bits;
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
        while (e < 63 && p >> e >= 2048)
            e++;
        if (p >> e << e != p)
            return -1;
        bits = ((uint64_t)e << 10) + (p >> e);
    }
    if (bits >= 0x7C00)
        return -1;
    return (int32_t)bits | (n < 0 ? 0x8000 : 0);
}

/* 7.12: writes the cells to s->nodes. The result is whether there are as many cells as anchors. */
static int DECODE_CELLS(struct scene *s, struct stream *stream, uint64_t anchors)
{
    uint16_t (*nodes)[3] = s->nodes, (*next)[3] = s->next_nodes;
    uint64_t count = 1, below;
    int whole = 1;
    memset(nodes[0], 0, sizeof nodes[0]);
    for (int level = CELL_LEVELS - 1; level >= 0; level--) {
        uint16_t (*models)[16] = s->position_model + 6 * (level < 2 ? level : 2);
        for (uint64_t i = 0; i < count; i++) {
            s->halves[i] = (uint8_t)DECODE_SYMBOL(stream, (uint32_t)(i % stream->lanes), models[0]);
            NOTE_SYMBOL(stream, s->halves[i]);
        }
        below = 0;
        for (uint64_t i = 0; i < count; i++) {
            unsigned a = s->halves[i], b, named = (a & 1) + (a >> 1 & 1) + (a >> 2 & 1) + (a >> 3);
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

/* 7.12, 6.11: R6.11-8, R6.11-9; reads the positions of a chunk in form 1 */
static void DECODE_POSITIONS(struct scene *s, struct piece p, uint64_t anchors)
{
    struct stream stream;
    int whole;
    OPEN(&stream, p, s->h.lanes_log2[1]);
    whole = DECODE_CELLS(s, &stream, anchors);
    END(&stream);
    REFUSE_IF(!whole, POSITIONS_COUNT, p.at);
    for (uint64_t i = 0; i < 3 * anchors; i++) {
        int32_t bits = CELL_NUMBER(s->nodes[i / 3][i % 3], s->cell_shift);
        REFUSE_IF(bits < 0, POSITIONS_CELL, p.at);
        s->position_bits[i] = (uint16_t)bits;
    }
}

/* 6.11: R6.11-10, of a chunk at `at` */
static void CHECK_BOUNDS(const struct scene *s, const struct chunk *c, uint64_t at)
{
    for (int a = 0; a < 3; a++) {
        int32_t low = INT32_MAX, high = INT32_MIN;
        for (uint64_t n = 0; n < c->anchors; n++) {
            int32_t x = F16_ORDER(s->position_bits[3 * n + (uint64_t)a]);
            low = x < low ? x : low;
            high = x > high ? x : high;
        }
        REFUSE_IF(low != F16_ORDER(c->low[a]) || high != F16_ORDER(c->high[a]), CHUNK_BOUNDS, at);
    }
}

/* 9.1: origin + S P is below 2^62 + 2^56 in magnitude */
static uint32_t WORLD(const struct header *h, uint64_t axis, uint32_t bits)
{
    return ROUND_F32(h->origin[axis] + h->scale_mantissa * POSITION_INTEGER(bits), h->scale_exponent - 24);
}

/* 9.1, 9.3 */
static void RECONSTRUCT_POSITIONS(struct scene *s, uint64_t anchors)
{
    for (uint64_t i = 0; i < 3 * anchors; i++)
        PUT_U32(s->values + 4 * i, WORLD(&s->h, i % 3, s->position_bits[i]));
    EMIT(&s->part[POSITIONS], s->values, 12 * anchors);
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
    SURE(n >= unit && n < INT64_C(1) << 31);
    f = (2 * n - unit) * unit / n;
    for (int r = 0; r < 3; r++)
        v[r] = FLOOR_DIV(v[r] * f, n);
}

/* 7.5.3 */
static void RESCALE(const struct frame *f, int64_t w[3])
{
    const int64_t unit = INT64_C(1) << UNIT_BITS;
    for (int r = 0; r < 3; r++) {
        int64_t range = f->high[r] - f->low[r];
        SURE(range > 0);
        w[r] = CLAMP(FLOOR_DIV((w[r] - f->low[r]) * unit, range), 0, unit);
    }
}

/* 7.5.4: g is below 2^27, and the sum with the rounding term is below 2^31 */
static void QUERY(const int16_t *plane, int32_t channels, int32_t size, const int64_t u[2], unsigned plane_shift,
                  int32_t *out)
{
    int32_t cell[2], weight[2];
    for (int a = 0; a < 2; a++) {
        int32_t g = (int32_t)u[a] * (size - 1);
        int32_t c = g >> UNIT_BITS < size - 2 ? g >> UNIT_BITS : size - 2;
        SURE(c >= 0);
        cell[a] = c;
        weight[a] = (int32_t)RSHIFT_ROUND(g - (c << UNIT_BITS), UNIT_BITS - LERP_BITS);
    }
    for (int32_t k = 0; k < channels; k++) {
        const int16_t *y = plane + (k * size + cell[1]) * size + cell[0];
        int64_t fj = weight[0], fi = weight[1], one = 1 << LERP_BITS;
        int64_t t = y[0] * (one - fj) * (one - fi) + y[1] * fj * (one - fi);
        t += y[size] * (one - fj) * fi + y[size + 1] * fj * fi;
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

/* 7.5: the 2 ch + 2 L inputs of F_h for anchor n of the chunk */
static void CONTEXT(const struct scene *s, uint64_t n, int32_t *out)
{
    int32_t channels = s->h.plane_channels, size = (int32_t)s->h.plane_size;
    int64_t position[3], u[3];
    uint64_t anchor = s->first_anchor + n;
    for (uint64_t a = 0; a < 3; a++)
        position[a] = POSITION_INTEGER(s->position_bits[3 * n + a]);
    PROBE_POINT("P", anchor, position);
    if (!channels && !s->h.frequency_count) /* there is no frame */
        return;
    FRAME_COORDINATES(&s->frame, position, u);
    PROBE_POINT("v", anchor, u);
    CONTRACT(u);
    PROBE_POINT("w", anchor, u);
    RESCALE(&s->frame, u);
    PROBE_POINT("u", anchor, u);
    if (channels) {
        QUERY(s->plane[0], channels, size, u, s->plane_shift, out);
        QUERY(s->plane_2, channels, 2 * size, u, s->plane_shift, out + channels);
        PROBE("samples.r1", anchor, out, (uint64_t)channels);
        PROBE("samples.r2", anchor, out + channels, (uint64_t)channels);
    }
    GAMMA(u[2], s->h.frequency_count, out + 2 * channels);
    PROBE("gamma", anchor, out + 2 * channels, 2 * (uint64_t)s->h.frequency_count);
}

/* ---------------------------------------------------------------- 7.6 masks */

/* 7.6: writes the K bits of each anchor */
static void DECODE_MASKS(struct stream *s, const uint32_t *mask_model, uint32_t offset_count, uint32_t anchors,
                         uint8_t *masks)
{
    for (uint32_t k = 0; k < offset_count; k++)
        for (uint32_t n = 0; n < anchors; n++) {
            uint8_t *m = masks + (uint64_t)n * offset_count;
            uint32_t kept = 0, f;
            uint16_t model[2];
            for (uint32_t i = 0; i < k; i++)
                kept += m[i];
            f = mask_model[k * (k + 1) / 2 + kept];
            model[0] = (uint16_t)((1 << PRECISION) - f);
            model[1] = (uint16_t)f;
            m[k] = (uint8_t)DECODE_SYMBOL(s, n % s->lanes, model);
            NOTE_SYMBOL(s, m[k]);
        }
}

/* ---------------------------------------------------------------- 7.7 to 7.10 attributes */

/* 7.10, 7.7: decodes the group of channels first to first + width - 1. `change` has the outputs of CARM, or is a null
   pointer. */
static void DECODE_STAGE(struct scene *s, struct stream *stream, uint64_t anchors, uint32_t first, uint32_t width,
                         const int32_t *change)
{
    uint32_t d = s->h.channels, kinds = s->h.features + 6;
    uint64_t count = 0;
    for (int pass = 0; pass < 2; pass++) {
        for (uint64_t n = 0; n < anchors; n++) {
            const uint8_t *mask = s->masks + n * s->h.offset_count;
            const int32_t *own = s->parameters + n * (2 * d + 3);
            for (uint32_t i = 0; i < width; i++) {
                uint32_t channel = first + i;
                if (channel >= kinds && !mask[(channel - kinds) / 3])
                    continue;
                if (pass) {
                    s->symbols[n * d + channel] = s->group[count++].value;
                    continue;
                }
                s->group[count].mean = own[channel] + (change ? change[n * 2 * width + i] : 0);
                s->group[count++].scale = own[d + channel] + (change ? change[n * 2 * width + width + i] : 0);
            }
        }
        if (!pass)
            DECODE_VALUES(stream, GAUSS, s->group, count, ATTRIBUTE_SYMBOL_MAX);
        count = 0;
    }
}

/* 7.9: the outputs of CARM for slice i, which begins at channel `first` */
static void CHANNEL_CONTEXT(struct scene *s, uint32_t i, uint32_t first, uint64_t anchors)
{
    int32_t inputs[FEATURES_MAX] = {0};
    SURE(first <= FEATURES_MAX);
    for (uint64_t n = 0; n < anchors; n++) {
        for (uint32_t k = 0; k < first; k++)
            inputs[k] = ACTIVATION(RSHIFT_ROUND(s->symbols[n * s->h.channels + k], s->carm_shift[k]));
        NETWORK(&s->networks[CARM_1 + i - 1], inputs, s->change + n * 2 * s->h.slice_width.item[i]);
    }
    for (uint64_t n = 0; n < anchors; n++) {
        const int32_t *own = s->parameters + n * (2 * s->h.channels + 3);
        const int32_t *change = s->change + n * 2 * s->h.slice_width.item[i];
        uint32_t width = s->h.slice_width.item[i];
        PROBE_SLICE((int)i, "means", s->first_anchor + n, own + first, change, width);
        PROBE_SLICE((int)i, "scales", s->first_anchor + n, own + s->h.channels + first, change + width, width);
    }
}

/* 5.14, 7.7, 7.10: symbols of masked offsets stay 0 */
static void DECODE_ATTRIBUTES(struct scene *s, struct piece p, uint64_t anchors)
{
    const struct header *h = &s->h;
    uint32_t d = h->channels, first = 0;
    struct stream stream;
    OPEN(&stream, p, h->lanes_log2[2]);
    for (uint64_t n = 0; n < anchors; n++) {
        int32_t context[WIDTH_MAX] = {0};
        CONTEXT(s, n, context);
        NETWORK(&s->networks[HYPER], context, s->parameters + n * (2 * d + 3));
        PROBE("means", s->first_anchor + n, s->parameters + n * (2 * d + 3), d);
        PROBE("scales", s->first_anchor + n, s->parameters + n * (2 * d + 3) + d, d);
        PROBE("step_outputs", s->first_anchor + n, s->parameters + n * (2 * d + 3) + 2 * d, 3);
    }
    memset(s->symbols, 0, (size_t)(anchors * d * sizeof *s->symbols));
    DECODE_STAGE(s, &stream, anchors, h->features, 6, NULL);
    DECODE_STAGE(s, &stream, anchors, h->features + 6, 3u * h->offset_count, NULL);
    for (uint32_t i = 0; i < h->slice_width.count; i++) {
        if (i)
            CHANNEL_CONTEXT(s, i, first, anchors);
        DECODE_STAGE(s, &stream, anchors, first, h->slice_width.item[i], i ? s->change : NULL);
        first += h->slice_width.item[i];
    }
    END(&stream);
}

/* 9.2: the base step is m * 2^e, with m below 2^24 */
static uint32_t STEP_VALUE(int64_t step_index, uint32_t base_step)
{
    int64_t m;
    int e;
    SPLIT_F32(base_step, &m, &e);
    return ROUND_F32(STEP[step_index] * m, e - STEP_SHIFT);
}

/* 9.2: an f32 holds the symbol. Wider intermediate results are exact, because the product has 48 bits at most. */
static uint32_t VALUE(int32_t symbol, uint32_t step)
{
    float product = (float)symbol * F32(step);
    uint32_t bits;
    memcpy(&bits, &product, 4);
    return bits;
}

/* 7.8, 9.2: the values of channels first to first + width - 1, of kind a */
static void RECONSTRUCT(struct scene *s, uint64_t anchors, int a, uint32_t first, uint32_t width)
{
    uint64_t d = s->h.channels;
    uint8_t *value = s->values;
    int32_t steps[3];
    for (uint64_t n = 0; n < anchors; n++) {
        int64_t index = CLAMP(s->parameters[n * (2 * d + 3) + 2 * d + (uint64_t)a], 0, STEP_LENGTH - 1);
        for (uint32_t i = 0; i < width; i++, value += 4)
            PUT_U32(value, VALUE(s->symbols[n * d + first + i], s->step[a][index]));
        s->step_index[3 * n + (uint64_t)a] = (uint8_t)index;
        for (int kind = 0; kind < 3; kind++)
            steps[kind] = s->step_index[3 * n + (uint64_t)kind];
        if (a == 2)
            PROBE("steps", s->first_anchor + n, steps, 3);
    }
    EMIT(&s->part[FEATURES + a], s->values, 4 * anchors * width);
}

/* ---------------------------------------------------------------- 9.4 static scenes */

/* 9.4: exp(t / 2^SCALING_BITS) is nearly m * 2^n, for |t| <= SCALING_BOUND. y is below 2^52 in magnitude, a product
   below 2^61. */
static int64_t EXPONENTIAL(int64_t t, int *n)
{
    static const int64_t EXP2[7] = {1073741824, 744260848, 257945537, 59571654, 10398739, 1330132, 234908};
    const int64_t LOG2_E = 1549082005;
    int64_t y = t * LOG2_E, whole = RSHIFT(y, 46), fraction = (y - whole * (INT64_C(1) << 46)) >> 16, m = EXP2[6];
    SURE(fraction >= 0 && fraction < INT64_C(1) << 30);
    for (int i = 5; i >= 0; i--)
        m = EXP2[i] + (m * fraction >> 30);
    *n = (int)whole - 30;
    return m;
}

/* 9.4: for two finite f32 whose sum is normal or zero. Of two with exponents so far apart the greater is normal, and
   the other is below a quarter of its unit, so it has no effect. Otherwise the sum is below 2^57. */
static uint32_t ADD_F32(uint32_t a, uint32_t b)
{
    int64_t m, n;
    int e, d, shift;
    SPLIT_F32(a, &m, &e);
    SPLIT_F32(b, &n, &d);
    shift = e - d;
    if (shift > 32)
        return a;
    if (shift < -32)
        return b;
    return shift > 0 ? ROUND_F32(m * (INT64_C(1) << shift) + n, d) : ROUND_F32(m + n * (INT64_C(1) << -shift), e);
}

/* 9.2: the value of a channel of kind a of anchor n of the chunk */
static uint32_t CHANNEL(const struct scene *s, uint64_t n, int a, uint32_t channel)
{
    uint8_t index = s->step_index[3 * n + (uint64_t)a];
    SURE(index < STEP_LENGTH);
    return VALUE(s->symbols[n * s->h.channels + channel], s->step[a][index]);
}

/* 9.3, 9.4: the Gaussians of anchor n of the chunk. By the bounds of 6.2, 6.4 and 9.4 all numbers are normal or zero: a
   product of an offset is 0 or from 2^-103 to 2^126 in magnitude, and a position is a multiple of 2^-84 below 2^99. */
static void SPLAT(struct scene *s, uint64_t n)
{
    const struct header *h = &s->h;
    const uint8_t *mask = s->masks + n * h->offset_count;
    int32_t inputs[FEATURES_MAX] = {0}, opacity[OFFSETS_MAX] = {0}, covariance[7 * OFFSETS_MAX] = {0};
    int32_t colour[COLOURS_MAX * OFFSETS_MAX] = {0};
    uint8_t numbers[4 * (11 + COLOURS_MAX) * OFFSETS_MAX] = {0}, *out = numbers;
    int64_t scaling[6], m[3];
    int e[3];
    for (uint32_t i = 0; i < h->features; i++)
        inputs[i] = ACTIVATION(ROUND_SCALED(CHANNEL(s, n, 0, i), 0));
    NETWORK(&s->networks[OPACITY], inputs, opacity);
    NETWORK(&s->networks[COVARIANCE], inputs, covariance);
    NETWORK(&s->networks[COLOUR], inputs, colour);
    for (uint32_t i = 0; i < 6; i++)
        scaling[i] =
            CLAMP(ROUND_SCALED(CHANNEL(s, n, 1, h->features + i), SCALING_BITS), -SCALING_BOUND, SCALING_BOUND);
    for (int i = 0; i < 3; i++)
        m[i] = EXPONENTIAL(scaling[i], &e[i]);
    for (uint32_t k = 0; k < h->offset_count; k++) {
        const int32_t *c = covariance + 7 * k;
        int turned = c[3] || c[4] || c[5] || c[6];
        if (!mask[k])
            continue;
        for (uint32_t i = 0; i < 3; i++, out += 4) {
            int64_t own;
            int d;
            SPLIT_F32(CHANNEL(s, n, 2, h->features + 6 + 3 * k + i), &own, &d);
            PUT_U32(out, ADD_F32(WORLD(h, i, s->position_bits[3 * n + i]), ROUND_F32(own * m[i], d + e[i])));
        }
        for (int i = 0; i < 3; i++, out += 4)
            PUT_U32(out, ROUND_F32(scaling[3 + i] + c[i] * (1 << (SCALING_BITS - OUTPUT_BITS)), -SCALING_BITS));
        for (int i = 3; i < 7; i++, out += 4)
            PUT_U32(out, ROUND_F32(!turned && i == 3 ? 1 << OUTPUT_BITS : c[i], -OUTPUT_BITS));
        PUT_U32(out, ROUND_F32(opacity[k], -OUTPUT_BITS));
        out += 4;
        for (uint32_t i = 0; i < h->colour_outputs; i++, out += 4)
            PUT_U32(out, ROUND_F32(colour[h->colour_outputs * k + i], -OUTPUT_BITS));
    }
    EMIT(&s->part[SPLATS], numbers, (uint64_t)(out - numbers));
}

/* ---------------------------------------------------------------- 5.14, 6.11 chunks */

/* 5.14, 6.11, 10.1: a chunk as a whole */
static void DECODE_CHUNK(struct scene *s, const struct chunk *c, struct piece p)
{
    const struct header *h = &s->h;
    uint64_t sum = CHUNK_HEAD_LENGTH, kept = 0, n = c->anchors;
    struct piece part[3]; /* positions, masks, attributes */
    struct stream stream;
    uint8_t form;
    REFUSE_IF(CRC32(0, p.data, p.length) != c->crc, CHUNK_CRC, p.at);
    REFUSE_IF(!ZERO(p, 13, 16), CHUNK_RESERVED, p.at + 13);
    form = p.data[12];
    REFUSE_IF(form > s->packed, CHUNK_FORM, p.at + 12);
    for (int i = 0; i < 3; i++) {
        part[i].length = GET_U32(p.data + 4 * i);
        part[i].at = p.at + sum;
        sum += PAD4(part[i].length);
    }
    REFUSE_IF(sum != p.length || (!form && part[0].length != 6 * n), CHUNK_LENGTH, p.at);
    for (int i = 0; i < 3; i++) {
        uint64_t from = part[i].at - p.at;
        part[i] = CUT(p, from, part[i].length);
        if (!ZERO(p, from + part[i].length, from + PAD4(part[i].length)))
            REFUSE(CHUNK_PADDING, part[i].at + part[i].length);
    }
    if (form)
        DECODE_POSITIONS(s, part[0], n);
    else
        RAW_POSITIONS(s, part[0]);
    CHECK_BOUNDS(s, c, p.at);
    OPEN(&stream, part[1], h->lanes_log2[1]);
    DECODE_MASKS(&stream, s->mask_model, h->offset_count, c->anchors, s->masks);
    END(&stream);
    for (uint64_t i = 0; i < n * h->offset_count; i++)
        kept += s->masks[i];
    REFUSE_IF(kept != c->kept, CHUNK_KEPT, p.at);
    DECODE_ATTRIBUTES(s, part[2], n);
    RECONSTRUCT_POSITIONS(s, n);
    EMIT(&s->part[MASKS], s->masks, n * h->offset_count);
    RECONSTRUCT(s, n, 0, 0, h->features);
    RECONSTRUCT(s, n, 1, h->features, 6);
    RECONSTRUCT(s, n, 2, h->features + 6, 3u * h->offset_count);
    for (uint64_t i = 0; h->render_model == STATIC && i < n; i++)
        SPLAT(s, i);
}

/* 5.14, 10.1, 13.1: DATA. What it needs is for the largest chunk. */
static void CHUNKS(struct scene *s, const struct entry *e)
{
    const struct header *h = &s->h;
    uint64_t start = input_at, n = s->largest, k3 = 3u * h->offset_count, widest = k3 < 6 ? 6 : k3, wide = widest;
    struct chunk c;
    for (int i = 0; i < h->slice_width.count; i++)
        widest = widest < h->slice_width.item[i] ? h->slice_width.item[i] : widest;
    wide = wide < h->features ? h->features : wide;
    s->position_bits = ALLOCATE(n, 6);
    s->nodes = ALLOCATE(n + 1, sizeof *s->nodes);
    s->next_nodes = ALLOCATE(n + 1, sizeof *s->next_nodes);
    s->halves = ALLOCATE(n + 1, 1);
    s->masks = ALLOCATE(n, h->offset_count);
    s->parameters = ALLOCATE(n, (2 * (uint64_t)h->channels + 3) * sizeof *s->parameters);
    s->change = ALLOCATE(n, 2 * widest * sizeof *s->change);
    s->symbols = ALLOCATE(n, h->channels * sizeof *s->symbols);
    s->group = ALLOCATE(n, widest * sizeof *s->group);
    s->values = ALLOCATE(n, 4 * wide);
    s->step_index = ALLOCATE(n, 3);
    for (int a = 0; a < 3; a++)
        for (int q = 0; q < STEP_LENGTH; q++)
            s->step[a][q] = STEP_VALUE(q, h->base_step[a]);
    for (uint32_t i = 0; i < h->chunk_count; i++) {
        struct piece p;
        ENTRY(s->entries, i, &c);
        p = READ(&s->section, c.length);
        REFUSE_IF(p.length < c.length, SECTION_TRUNCATED, input_at);
        DECODE_CHUNK(s, &c, p);
        s->first_anchor += c.anchors;
    }
    REFUSE_IF(e->crc, SECTION_CRC, start);
}

/* ---------------------------------------------------------------- 10.1 the file */

/* 9.3: the number of the scene's parts */
static int PART_COUNT(const struct header *h) { return h->render_model == STATIC ? PARTS : SPLATS; }

/* 9.3: where each part begins in OUTPUT. The last has any length. */
static void PARTS_BEGIN(struct scene *s)
{
    const struct header *h = &s->h;
    uint64_t n = h->anchor_count, at = HEAD_LENGTH + h->drawn_length + 32 * (uint64_t)PART_COUNT(h);
    const uint64_t length[PARTS] = {12 * n,
                                    n * h->offset_count,
                                    10 * (uint64_t)h->plane_channels * h->plane_size * h->plane_size,
                                    4 * n * h->features,
                                    24 * n,
                                    12 * n * h->offset_count,
                                    4 * WEIGHT_COUNT(s->networks, 0, NETWORKS),
                                    0};
    for (int i = 0; i < PARTS; i++) {
        SHA_START(&s->part[i].digest);
        s->part[i].at = at;
        at += length[i];
    }
}

/* 9.3: writes what the scene's digest is of to OUTPUT, if there is one; prints all digests, if they are wanted */
static void PARTS_END(struct scene *s, int print)
{
    static const char names[PARTS][10] = {"positions", "masks",   "planes",  "features",
                                          "scalings",  "offsets", "weights", "splat"};
    uint8_t head[HEAD_LENGTH], digests[PARTS][32] = {{0}}, digest[32] = {0};
    struct part whole = {.at = 0};
    int parts = PART_COUNT(&s->h);
    memcpy(head, s->h.later ? "C3GSREC2" : "C3GSREC1", 8);
    PUT_U32(head + 8, s->h.anchor_count);
    for (int i = 0; i < parts; i++)
        SHA_END(&s->part[i].digest, digests[i]);
    SHA_START(&whole.digest);
    EMIT(&whole, head, sizeof head);
    EMIT(&whole, s->h.drawn, s->h.drawn_length);
    EMIT(&whole, *digests, 32 * (uint64_t)parts);
    SHA_END(&whole.digest, digest);
    if (!print)
        return;
    printf("whole %s\n", HEX(digest));
    for (int i = 0; i < parts; i++)
        printf("%s %s\n", names[i], HEX(digests[i]));
}

/* 7.1, 10.1, 10.2, 15.4, H: the order of decoding and of checks. print: whether the digests are wanted. */
static void DECODE_FILE(struct scene *s, int print)
{
    struct header *h = &s->h;
    uint64_t data_length = 0;
    PROLOGUE(h, &s->section);
    HEADER_FIELDS(h, &s->section);
    HEADER(h, s->networks);
    DIRECTORY(h, s->networks);
    PARTS_BEGIN(s);
    for (uint32_t i = 0; i < h->section_count; i++)
        if (h->directory[i].section == DATA)
            data_length = h->directory[i].length;
    for (uint32_t i = 0; i < h->section_count; i++) {
        const struct entry *e = &h->directory[i];
        switch (e->section) {
        case FRAM:
            FRAME(s, SECTION(e, &s->section));
            break;
        case WGTS:
            READ_WEIGHTS(s, SECTION(e, &s->section), e->mode);
            break;
        case PLNS:
            READ_PLANES(s, SECTION(e, &s->section));
            JOIN_QUADRANTS(s);
            break;
        case INDX:
            READ_INDEX(s, SECTION(e, &s->index), e->mode, data_length);
            break;
        case DATA:
            CHUNKS(s, e);
            break;
        default:
            SKIP_SECTION(e, &s->section);
        }
    }
    REFUSE_IF(READ(&s->section, 1).length, FILE_TRAILING, input_at - 1);
    PARTS_END(s, print);
}

/* not of the specification */
static void LOAD_TABLES(const char *program, struct buffer *b)
{
    const char *tables = getenv("C3GS_TABLES"), *slash = strrchr(program, '/');
    char *path = NULL;
    struct piece p;
    if (!tables) {
        size_t folder = slash ? (size_t)(slash - program) + 1 : 0;
        path = ALLOCATE(folder + 16, 1);
        memcpy(path, program, folder);
        memcpy(path + folder, "tables-0.bin", 13);
    }
    input = fopen(tables ? tables : path, "rb");
    FAIL_IF(!input, "cannot open the table file");
    p = READ(b, TABLES_LENGTH + 1);
    READ_TABLES(p.data, p.length);
    fclose(input);
    input = NULL;
    input_at = 0;
}

/* not of the specification: the name of a file without links and `.` or `..`, whether it is there or not */
static char *PLACE(const char *path)
{
    char *whole = realpath(path, NULL), *folder = NULL;
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path;
    size_t length = (size_t)(name - path);
    if (whole)
        return whole;
    if (length && (folder = malloc(length + 1))) {
        memcpy(folder, path, length);
        folder[length] = 0;
    }
    if (folder || !length)
        whole = realpath(length ? folder : ".", NULL);
    free(folder);
    folder = whole;
    FAIL_IF(!folder || !(whole = malloc(strlen(folder) + strlen(name) + 2)), "cannot open the output");
    sprintf(whole, "%s/%s", folder, name);
    free(folder);
    return whole;
}

/* not of the specification: fails if two names are one file, which would be lost. Pipes and devices keep nothing. */
static void APART(const char *a, const char *b)
{
    struct stat x, y;
    char *first, *second;
    int there = !stat(a, &x), same = there && !stat(b, &y) && x.st_dev == y.st_dev && x.st_ino == y.st_ino;
    if (there && !S_ISREG(x.st_mode))
        return;
    first = PLACE(a);
    second = PLACE(b);
    same |= !strcmp(first, second);
    free(first);
    free(second);
    FAIL_IF(same, "an output is the input, or another output");
}

/* not of the specification: opens a file beside the output's place, or what is there if it is no ordinary file */
static void OPEN_OUTPUT(struct outgoing *o, const char *path)
{
    struct stat found;
    if (!stat(path, &found) && !S_ISREG(found.st_mode)) {
        *o->file = fopen(path, "wb");
    } else {
        o->place = PLACE(path);
        if ((o->beside = malloc(strlen(o->place) + 16)))
            for (int i = 0; i < 10000 && !*o->file; i++) {
                strcpy(o->beside, o->place);
                sprintf(strrchr(o->beside, '/') + 1, ".decoder-%d", i);
                *o->file = fopen(o->beside, "wbx");
            }
        if (!*o->file) { /* what is there is another's */
            free(o->beside);
            o->beside = NULL;
        }
    }
    FAIL_IF(!*o->file, "cannot open the output");
}

/* not of the specification */
int main(int argc, char **argv)
{
    static struct scene s;
    int decode = (argc == 4 || argc == 5) && !strcmp(argv[1], "decode");
    if (!decode && (argc != 3 || strcmp(argv[1], "digest")))
        FAIL("usage: decoder digest FILE | decoder decode FILE OUTPUT [PROBES]");
    signal(SIGXFSZ, SIG_IGN); /* a file that is too long is a failure of output, which leaves nothing behind */
    MAKE_CRC_TABLE();
    LOAD_TABLES(argv[0], &s.section);
    input = fopen(argv[2], "rb");
    FAIL_IF(!input, "cannot open the file");
    for (int i = 3; i < argc; i++)
        for (int j = 2; j < i; j++)
            APART(argv[i], argv[j]);
    if (argc == 5)
        OPEN_OUTPUT(&traced, argv[4]);
    DECODE_FILE(&s, !decode);
    if (probes)
        CLOSE_OUTPUT(&traced);
    if (decode) { /* the file is right, and is decoded again */
        RELEASE_BLOCKS();
        memset(&s, 0, sizeof s);
        input_at = 0;
        FAIL_IF(fseek(input, 0, SEEK_SET), "cannot read the file again");
        OPEN_OUTPUT(&made, argv[3]);
        DECODE_FILE(&s, 0);
        CLOSE_OUTPUT(&made);
    }
    RELEASE();
    FAIL_IF(fflush(stdout) || ferror(stdout), "cannot write");
    return 0;
}
