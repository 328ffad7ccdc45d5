/* The Gaussians of a static scene (SPEC 9.4), in integers up to their last rounding. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "module.h"

/* The names are those of SPEC.md, as far as they are in it. */
enum {
    WIDTH_MAX = 128,
    OFFSETS_MAX = 16,
    HARMONICS_MAX = 48,
    ACTIVATION_MAX = 1023,
    SCALINGS = 6,
    OUTPUT_BITS = 12,
    SCALING_BITS = 16,
    SCALING_BOUND = 27 << SCALING_BITS,
    LOG2_E = 1549082005,
    /* The terms of the exponential. */
    TERMS = 7,
    /* Opacity, covariance and colour, in the order of the file. */
    NETWORKS = 3,
    /* The rows of an offset: 1 of opacity, 7 of covariance, and those of colour, each filled up to whole vectors. */
    LOGIT = 0,
    LENGTHS = 4,
    QUATERNION = 7,
    HARMONICS = 12,
    /* Rows that are computed together, and the inputs of a vector. What is filled up has the weight 0. */
    ROWS = 4,
    LANES = 8,
};

static const int64_t exp2_terms[TERMS] = {1073741824, 744260848, 257945537, 59571654, 10398739, 1330132, 234908};

/* Rows of integers (SPEC 7.2). weight: [rows][stride]. bias: [rows], with half a unit of the shift. shift: [rows]. */
typedef struct {
    uint32_t stride;
    int16_t *weight;
    int32_t *bias;
    uint8_t *shift;
} rows;

/* The networks. hidden: [NETWORKS][units] rows. last: [offsets][outputs] rows. */
typedef struct kernel_splatter {
    uint32_t features, offsets, colours, units, outputs;
    rows hidden, last;
} splatter;

static uint32_t whole(uint32_t count, uint32_t unit) { return (count + unit - 1) / unit * unit; }

static rows take_rows(pieces *p, uint64_t count, uint32_t inputs)
{
    uint32_t stride = whole(inputs, LANES);
    rows own = {stride, NULL, NULL, NULL};
    own.weight = piece(p, count * stride, 2);
    own.bias = piece(p, count, 4);
    own.shift = piece(p, count, 1);
    return own;
}

/* Where the rows of the next layer are. */
typedef struct {
    const int16_t *weight;
    const int32_t *bias;
    const uint8_t *exponent;
} source;

static void take_row(rows *to, uint32_t row, source *from, uint32_t inputs)
{
    uint8_t shift = *from->exponent++;
    memcpy(to->weight + (size_t)row * to->stride, from->weight, 2 * (size_t)inputs);
    to->bias[row] = *from->bias++ + (shift ? 1 << (shift - 1) : 0);
    to->shift[row] = shift;
    from->weight += inputs;
}

EXPORT("makeSplatter")
splatter *kernel_splatter_new(uint32_t features, uint32_t width, uint32_t offsets, uint32_t colours,
                              const int16_t *weight, const int32_t *bias, const uint8_t *exponent)
{
    if (features < 1 || features > WIDTH_MAX || width < 1 || width > WIDTH_MAX) return NULL;
    if (offsets < 1 || offsets > OFFSETS_MAX || colours < 1 || colours > HARMONICS_MAX) return NULL;
    splatter own = {features, offsets, colours, whole(width, ROWS), HARMONICS + whole(colours, ROWS),
                    {0, NULL, NULL, NULL}, {0, NULL, NULL, NULL}};
    pieces p = {NULL, 0};
    splatter *s = NULL;
    for (int pass = 0; pass < 2; pass++) {
        s = piece(&p, 1, sizeof own);
        own.hidden = take_rows(&p, (uint64_t)NETWORKS * own.units, features);
        own.last = take_rows(&p, (uint64_t)offsets * own.outputs, width);
        if (pass == 0 && !(p = (pieces){calloc(1, (size_t)p.used), 0}).block) return NULL;
    }
    *s = own;
    const uint32_t first[NETWORKS] = {LOGIT, LENGTHS, HARMONICS}, count[NETWORKS] = {1, 7, colours};
    source from = {weight, bias, exponent};
    for (uint32_t n = 0; n < NETWORKS; n++) {
        for (uint32_t o = 0; o < width; o++) take_row(&s->hidden, n * s->units + o, &from, features);
        for (uint32_t o = 0; o < offsets * count[n]; o++)
            take_row(&s->last, o / count[n] * s->outputs + first[n] + o % count[n], &from, width);
    }
    return s;
}

/* Four of the numbers of two vectors, by their places. */
#if defined(__clang__) || __GNUC__ >= 12
#define PICK(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define PICK(a, b, ...) __builtin_shuffle(a, b, (ints){__VA_ARGS__})
#endif

/* Returns a0 + a2, b0 + b2, a1 + a3, b1 + b3. */
static ints pair_sums(ints a, ints b) { return PICK(a, b, 0, 4, 1, 5) + PICK(a, b, 2, 6, 3, 7); }

/* SPEC 7.2: the outputs of `count` rows from `row` on, a multiple of ROWS. Each sum is below ACCUMULATOR_BOUND. */
static void outputs(const rows *r, uint32_t row, uint32_t count, const int16_t *inputs, int32_t *to)
{
    for (uint32_t end = row + count; row < end; row += ROWS, to += ROWS) {
        const int16_t *weight = r->weight + (size_t)row * r->stride;
        ints sum[ROWS] = {{0}, {0}, {0}, {0}};
        for (uint32_t i = 0; i < r->stride; i += LANES) {
            shorts own = *(const shorts *)(inputs + i);
            for (uint32_t j = 0; j < ROWS; j++)
                sum[j] += pair_products(own, *(const shorts *)(weight + (size_t)j * r->stride + i));
        }
        ints few = pair_sums(sum[0], sum[1]), more = pair_sums(sum[2], sum[3]);
        ints found = PICK(few, more, 0, 1, 4, 5) + PICK(few, more, 2, 3, 6, 7);
        found += *(const ints *)(r->bias + row);
        for (uint32_t j = 0; j < ROWS; j++) to[j] = found[j] >> r->shift[row + j];
    }
}

/* SPEC 2.4, ROUND_SCALED for a float and a power of two, limited. NaN, which no file gives, counts as -bound. */
static int32_t fixed(float x, int32_t unit, int32_t bound)
{
    /* Exact, except for small and large numbers, where the rounded sum has the same floor. */
    double y = __builtin_floor((double)x * unit + 0.5);
    return !(y > -bound) ? -bound : y > bound ? bound : (int32_t)y;
}

/* SPEC 9.4, EXPONENTIAL: returns m, and sets 2^n. */
static int64_t exponential(int32_t t, float *unit)
{
    int64_t y = (int64_t)t * LOG2_E, fraction = (y & ((INT64_C(1) << 46) - 1)) >> 16, m = exp2_terms[TERMS - 1];
    for (int i = TERMS - 2; i >= 0; i--) m = exp2_terms[i] + (m * fraction >> 30);
    uint32_t bits = (uint32_t)((y >> 46) - 30 + 127) << 23;
    memcpy(unit, &bits, sizeof bits);
    return m;
}

/* SPEC 9.4: ROUND_F32 of x * m * unit. Other numbers than those of 9.2 give any number. */
static float product(float x, int64_t m, float unit)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    uint32_t exponent = bits >> 23 & 255;
    if (exponent == 0) return 0;
    int64_t own = (int64_t)((bits & 0x7fffff) | 0x800000) * m;
    /* The conversion rounds. The product with powers of two is exact: an offset is 0 or at least 2^-64. */
    float rounded = (float)(bits >> 31 ? -own : own);
    uint64_t scale = (uint64_t)(exponent - 150 + 1023) << 52;
    double power;
    memcpy(&power, &scale, sizeof scale);
    return (float)((double)rounded * power * (double)unit);
}

/* SPEC 9.4, SPLAT. */
EXPORT("splat")
int32_t kernel_splat(const splatter *s, uint32_t count, const float *position, const uint8_t *mask,
                     const float *feature, const float *scaling, const float *offset, uint32_t room, uint32_t stride,
                     float *mean, float *length, float *quaternion, float *logit, float *harmonic)
{
    const float output_unit = 1.0f / (1 << OUTPUT_BITS), scaling_unit = 1.0f / (1 << SCALING_BITS);
    int16_t inputs[WIDTH_MAX] = {0}, hidden[NETWORKS][WIDTH_MAX] = {{0}};
    int32_t own[WIDTH_MAX];
    uint32_t found = 0;
    for (uint32_t a = 0; a < count; a++, mask += s->offsets, offset += 3 * s->offsets) {
        int any = 0;
        for (uint32_t k = 0; k < s->offsets; k++) any |= mask[k];
        if (!any) continue;
        for (uint32_t i = 0; i < s->features; i++)
            inputs[i] = (int16_t)fixed(feature[(size_t)s->features * a + i], 1, ACTIVATION_MAX);
        for (uint32_t n = 0; n < NETWORKS; n++) {
            outputs(&s->hidden, n * s->units, s->units, inputs, own);
            for (uint32_t o = 0; o < s->units; o++)
                hidden[n][o] = (int16_t)(own[o] < 0 ? 0 : own[o] > ACTIVATION_MAX ? ACTIVATION_MAX : own[o]);
        }
        int32_t scales[SCALINGS];
        for (int i = 0; i < SCALINGS; i++)
            scales[i] = fixed(scaling[(size_t)SCALINGS * a + (size_t)i], 1 << SCALING_BITS, SCALING_BOUND);
        int64_t m[3];
        float unit[3];
        for (int axis = 0; axis < 3; axis++) m[axis] = exponential(scales[axis], &unit[axis]);
        for (uint32_t k = 0; k < s->offsets; k++) {
            if (!mask[k]) continue;
            if (found == room) return KERNEL_REFUSED;
            const uint32_t first[NETWORKS + 1] = {LOGIT, LENGTHS, HARMONICS, s->outputs};
            for (uint32_t n = 0; n < NETWORKS; n++)
                outputs(&s->last, k * s->outputs + first[n], first[n + 1] - first[n], hidden[n], own + first[n]);
            for (int axis = 0; axis < 3; axis++) {
                /* ADD_F32. The 0 turns -0 into +0. */
                mean[axis] = position[(size_t)3 * a + (size_t)axis] +
                             product(offset[3 * k + (uint32_t)axis], m[axis], unit[axis]) + 0.0f;
                int32_t sum = scales[3 + axis] + own[LENGTHS + axis] * (1 << (SCALING_BITS - OUTPUT_BITS));
                length[axis] = (float)sum * scaling_unit;
            }
            int32_t *turn = own + QUATERNION;
            if (!(turn[0] | turn[1] | turn[2] | turn[3])) turn[0] = 1 << OUTPUT_BITS;
            for (int i = 0; i < 4; i++) quaternion[i] = (float)turn[i] * output_unit;
            *logit = (float)own[LOGIT] * output_unit;
            for (uint32_t i = 0; i < s->colours; i++) harmonic[i] = (float)own[HARMONICS + i] * output_unit;
            mean += stride ? stride : 3;
            length += stride ? stride : 3;
            quaternion += stride ? stride : 4;
            logit += stride ? stride : 1;
            harmonic += stride ? stride : s->colours;
            found++;
        }
    }
    return (int32_t)found;
}
