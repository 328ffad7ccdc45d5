/* The Gaussians that a place sees (SPEC 14.3), in float32.
 *
 * The networks take the features, a direction and a distance. The part of their first layers that the features give
 * depends on no place: it is computed once, when anchors are added. Further layers are computed for those offsets only
 * that the mask keeps, and colours and shapes for those only whose opacity is above 0.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include "../native/module.h"

/* The names are those of SPEC.md, as far as they are in it. */
enum {
    FEATURES_MAX = 128,
    RENDER_WIDTH_MAX = 128,
    OFFSETS_MAX = 16,
    SCALINGS = 6,
    /* Opacity, covariance and colour, in the order of the file. */
    OPACITY = 0,
    COVARIANCE,
    COLOUR,
    NETWORKS,
    /* A direction and a distance. */
    PLACE_INPUTS = 4,
    LANES = 4,
    /* The rows of an offset: 7 of covariance and 3 of colour, each filled up to whole vectors. */
    COVARIANCE_ROWS = 8,
    COLOUR_ROWS = 4,
    ROWS = COVARIANCE_ROWS + COLOUR_ROWS,
    /* The vectors of a first layer that are computed together. */
    TILE = 4,
};

/* What a function returns instead of a count. */
enum { REFUSED = -2 };

static const int outputs_of[NETWORKS] = {1, 7, 3};
static const int place_of[NETWORKS] = {0, 0, COVARIANCE_ROWS};

typedef float vector __attribute__((vector_size(16), aligned(4), may_alias));
typedef uint32_t bits __attribute__((vector_size(16), aligned(4), may_alias));

/* The networks. width: that of a hidden layer, filled up with zeros to whole vectors. */
typedef struct {
    uint32_t features, offsets, width;
    float distance_unit;
    /* Of the first layers: [features][NETWORKS][width], [PLACE_INPUTS][NETWORKS][width] and [NETWORKS][width]. */
    float *feature, *place, *bias;
    /* Of the second ones: [offsets][width], [offsets], [offsets][ROWS][width] and [offsets][ROWS]. */
    float *opacity, *opacity_bias, *row, *row_bias;
} renderer;

/* Anchors, and what of their Gaussians depends on no place. */
typedef struct {
    uint32_t count, kept, count_most, kept_most;
    /* [count][3] world positions, [count][NETWORKS][width] sums of first layers, [count][3] exponentials. */
    float *position, *sum, *axes;
    /* Of the kept offsets: [kept][3] means, and [kept] their numbers. first: [count + 1], those before an anchor. */
    float *mean;
    uint8_t *offset;
    uint32_t *first;
} anchors;

/* Where Gaussians go. */
typedef struct {
    float *position, *scale, *rotation, *colour, *opacity;
    uint32_t *anchor;
    uint8_t *offset;
} view;

static vector load(const float *from) { return *(const vector *)from; }

static vector all(float x) { return (vector){x, x, x, x}; }

/* which: all bits of a number, or none. */
static vector chosen(bits which, vector yes, vector no)
{
    return (vector)((which & (bits)yes) | (~which & (bits)no));
}

/* ------------------------------------------------------------------------------------------------ the networks -- */

/* Returns memory of zeros, or NULL. */
static void *zeros(uint64_t size) { return size <= SIZE_MAX ? calloc(1, (size_t)size) : NULL; }

/* Where the values of a layer lie in those of all layers: weights [outputs][inputs], and biases [outputs]. */
typedef struct {
    const float *weight, *bias;
    uint32_t outputs, inputs;
} layer;

static layer next_layer(const float **values, uint32_t outputs, uint32_t inputs)
{
    layer own = {*values, *values + (size_t)outputs * inputs, outputs, inputs};
    *values = own.bias + outputs;
    return own;
}

static void take_first(renderer *r, int network, layer own)
{
    for (uint32_t o = 0; o < own.outputs; o++) {
        size_t to = (size_t)network * r->width + o;
        r->bias[to] = own.bias[o];
        for (uint32_t i = 0; i < own.inputs; i++) {
            float *row = i < r->features ? r->feature + (size_t)i * NETWORKS * r->width
                                         : r->place + (size_t)(i - r->features) * NETWORKS * r->width;
            row[to] = own.weight[(size_t)o * own.inputs + i];
        }
    }
}

static void take_second(renderer *r, int network, layer own)
{
    for (uint32_t o = 0; o < own.outputs; o++) {
        uint32_t offset = o / (uint32_t)outputs_of[network];
        size_t row = (size_t)offset * ROWS + (size_t)place_of[network] + o % (uint32_t)outputs_of[network];
        float *to = network == OPACITY ? r->opacity + (size_t)offset * r->width : r->row + row * r->width;
        memcpy(to, own.weight + (size_t)o * own.inputs, 4 * (size_t)own.inputs);
        *(network == OPACITY ? r->opacity_bias + offset : r->row_bias + row) = own.bias[o];
    }
}

/* values: of all layers of the rendering networks in file order. Returns NULL without memory, or for wrong numbers. */
EXPORT("makeRenderer")
renderer *web_make_renderer(uint32_t features, uint32_t width, uint32_t offsets, float distance_unit,
                            const float *values, uint32_t count)
{
    if (features < 1 || features > FEATURES_MAX || width < 1 || width > RENDER_WIDTH_MAX) return NULL;
    if (offsets < 1 || offsets > OFFSETS_MAX) return NULL;
    uint32_t inputs = features + PLACE_INPUTS, needed = 0;
    for (int n = 0; n < NETWORKS; n++)
        needed += width * (inputs + 1) + offsets * (uint32_t)outputs_of[n] * (width + 1);
    if (count != needed) return NULL;
    renderer own = {features, offsets, (width + LANES - 1) / LANES * LANES, distance_unit, NULL, NULL, NULL, NULL,
                    NULL, NULL, NULL};
    pieces p = {NULL, 0};
    renderer *r = NULL;
    for (int pass = 0; pass < 2; pass++) {
        r = piece(&p, 1, sizeof own);
        own.feature = piece(&p, (uint64_t)features * NETWORKS * own.width, 4);
        own.place = piece(&p, (uint64_t)PLACE_INPUTS * NETWORKS * own.width, 4);
        own.bias = piece(&p, (uint64_t)NETWORKS * own.width, 4);
        own.opacity = piece(&p, (uint64_t)offsets * own.width, 4);
        own.opacity_bias = piece(&p, offsets, 4);
        own.row = piece(&p, (uint64_t)offsets * ROWS * own.width, 4);
        own.row_bias = piece(&p, (uint64_t)offsets * ROWS, 4);
        if (pass == 0 && !(p = (pieces){zeros(p.used), 0}).block) return NULL;
    }
    *r = own;
    for (int n = 0; n < NETWORKS; n++) {
        take_first(r, n, next_layer(&values, width, inputs));
        take_second(r, n, next_layer(&values, offsets * (uint32_t)outputs_of[n], width));
    }
    return r;
}

/* ------------------------------------------------------------------------------------------------- the anchors -- */

/* Makes room for so many anchors and kept offsets. Returns NULL without memory. */
EXPORT("makeAnchors") anchors *web_make_anchors(const renderer *r, uint32_t count, uint32_t kept)
{
    anchors own = {0, 0, count, kept, NULL, NULL, NULL, NULL, NULL, NULL};
    pieces p = {NULL, 0};
    anchors *a = NULL;
    for (int pass = 0; pass < 2; pass++) {
        a = piece(&p, 1, sizeof own);
        own.position = piece(&p, count, 3 * 4);
        own.sum = piece(&p, count, (uint64_t)NETWORKS * r->width * 4);
        own.axes = piece(&p, count, 3 * 4);
        own.mean = piece(&p, kept, 3 * 4);
        own.offset = piece(&p, kept, 1);
        own.first = piece(&p, (uint64_t)count + 1, 4);
        if (pass == 0 && !(p = (pieces){zeros(p.used), 0}).block) return NULL;
    }
    *a = own;
    return a;
}

/* What the features give of the first layers. */
static void first_layers(const renderer *r, const float *features, float *to)
{
    uint32_t whole = NETWORKS * r->width;
    uint32_t at = 0;
    for (; at + TILE * LANES <= whole; at += TILE * LANES) {
        vector sum[TILE];
        for (int t = 0; t < TILE; t++) sum[t] = load(r->bias + at + t * LANES);
        for (uint32_t f = 0; f < r->features; f++) {
            const float *weight = r->feature + (size_t)f * whole + at;
            for (int t = 0; t < TILE; t++) sum[t] += all(features[f]) * load(weight + t * LANES);
        }
        memcpy(to + at, sum, sizeof sum);
    }
    for (; at < whole; at += LANES) {
        vector sum = load(r->bias + at);
        for (uint32_t f = 0; f < r->features; f++) sum += all(features[f]) * load(r->feature + (size_t)f * whole + at);
        memcpy(to + at, &sum, sizeof sum);
    }
}

/* Appends anchors (SPEC 9.3). Returns 0, or REFUSED where they are more than there is room for. */
EXPORT("addAnchors")
int32_t web_add_anchors(const renderer *r, anchors *a, uint32_t count, const float *positions, const uint8_t *masks,
                        const float *features, const float *scalings, const float *offsets)
{
    if (count > a->count_most - a->count) return REFUSED;
    for (uint32_t i = 0; i < count; i++) {
        const float *position = positions + (size_t)3 * i, *scaling = scalings + (size_t)SCALINGS * i;
        memcpy(a->position + (size_t)3 * a->count, position, 3 * 4);
        first_layers(r, features + (size_t)r->features * i, a->sum + (size_t)NETWORKS * r->width * a->count);
        /* Products of exponentials that float32 does not hold can be numbers that it does. */
        double unit[3];
        for (int axis = 0; axis < 3; axis++) {
            unit[axis] = exp((double)scaling[axis]);
            a->axes[(size_t)3 * a->count + (size_t)axis] = (float)exp((double)scaling[3 + axis]);
        }
        for (uint32_t k = 0; k < r->offsets; k++) {
            if (!masks[(size_t)r->offsets * i + k]) continue;
            if (a->kept == a->kept_most) return REFUSED;
            const float *offset = offsets + 3 * ((size_t)r->offsets * i + k);
            for (int axis = 0; axis < 3; axis++)
                a->mean[(size_t)3 * a->kept + (size_t)axis] = (float)(position[axis] + offset[axis] * unit[axis]);
            a->offset[a->kept++] = (uint8_t)k;
        }
        a->first[++a->count] = a->kept;
    }
    return 0;
}

/* ------------------------------------------------------------------------------------------------ the functions -- */

/* e^x to float32's digits. Above e^88 it is infinite, and below e^-88 it is 0. NaN stays. */
static vector exponential(vector x)
{
    const float most = 88.0f, log2_e = 1.44269504f, shift = 12582912.0f;
    /* ln 2 as a number with few bits, so that its product with an integer is exact, and the rest. */
    const float high = 0.693359375f, low = -2.12194440e-4f;
    bits above = (bits)(x > all(most)), below = (bits)(x < all(-most));
    x = chosen(above | below, all(0), x);
    /* In the last bits of this sum is the nearest integer. */
    vector shifted = x * log2_e + shift;
    vector whole = shifted - shift;
    vector rest = x - whole * high - whole * low;
    vector sum = all(1.0f / 5040);
    sum = sum * rest + 1.0f / 720;
    sum = sum * rest + 1.0f / 120;
    sum = sum * rest + 1.0f / 24;
    sum = sum * rest + 1.0f / 6;
    sum = sum * rest + 0.5f;
    sum = sum * rest + 1.0f;
    sum = sum * rest + 1.0f;
    vector value = sum * (vector)(((bits)shifted - (bits)all(shift) + 127) << 23);
    return chosen(above, all(INFINITY), chosen(below, all(0), value));
}

/* SPEC 14.3, LOGISTIC. */
static vector logistic(vector x) { return 1.0f / (1.0f + exponential(-x)); }

/* The hyperbolic tangent of numbers above 0. */
static vector tangent(vector x)
{
    vector square = x * x;
    /* Its continued fraction, to the fifth term. Near 0, the other form would lose digits. */
    vector small = x * (945.0f + square * (105.0f + square)) / (945.0f + square * (420.0f + square * 15.0f));
    vector large = 1.0f - 2.0f / (exponential(x + x) + 1.0f);
    return chosen((bits)(x < all(0.5f)), small, large);
}

/* Returns a0 + a2, b0 + b2, a1 + a3, b1 + b3. */
static vector pair_sums(vector a, vector b)
{
    return __builtin_shufflevector(a, b, 0, 4, 1, 5) + __builtin_shufflevector(a, b, 2, 6, 3, 7);
}

/* Four sums of products of a hidden layer with rows. */
static vector products(const float *hidden, const float *const row[LANES], uint32_t width)
{
    vector sum[LANES] = {all(0), all(0), all(0), all(0)};
    for (uint32_t i = 0; i < width; i += LANES) {
        vector own = load(hidden + i);
        for (int lane = 0; lane < LANES; lane++) sum[lane] += own * load(row[lane] + i);
    }
    vector few = pair_sums(sum[0], sum[1]), more = pair_sums(sum[2], sum[3]);
    return __builtin_shufflevector(few, more, 0, 1, 4, 5) + __builtin_shufflevector(few, more, 2, 3, 6, 7);
}

/* The same with rows that lie one after the other, and their biases. */
static vector outputs(const float *hidden, const float *rows, const float *bias, uint32_t width)
{
    const float *const row[LANES] = {rows, rows + width, rows + 2 * (size_t)width, rows + 3 * (size_t)width};
    return products(hidden, row, width) + load(bias);
}

/* The hidden layer of a network. inputs: the direction and the distance. */
static void hidden_layer(const renderer *r, int network, const float *sum, const vector inputs[PLACE_INPUTS], float *to)
{
    for (uint32_t i = 0; i < r->width; i += LANES) {
        size_t at = (size_t)network * r->width + i;
        vector value = load(sum + at);
        for (int p = 0; p < PLACE_INPUTS; p++)
            value += inputs[p] * load(r->place + (size_t)p * NETWORKS * r->width + at);
        value = chosen((bits)(value < all(0)), all(0), value);
        memcpy(to + i, &value, sizeof value);
    }
}

/* Gives a quaternion the length 1. It is scaled first, because squares of small numbers vanish. */
static void normalise(const float from[4], float to[4])
{
    float most = 0, sum = 0;
    for (int i = 0; i < 4; i++) most = fabsf(from[i]) > most ? fabsf(from[i]) : most;
    for (int i = 0; i < 4; i++) to[i] = most > 0 ? from[i] / most : i == 0;
    for (int i = 0; i < 4; i++) sum += to[i] * to[i];
    float length = sqrtf(sum);
    for (int i = 0; i < 4; i++) to[i] /= length;
}

/* Writes a Gaussian but its opacity. Returns whether all its numbers are finite. */
static int write_gaussian(const renderer *r, const view *v, uint32_t at, const float *mean, const float *axes,
                          float hidden[NETWORKS][RENDER_WIDTH_MAX], uint32_t offset)
{
    const float *rows = r->row + (size_t)offset * ROWS * r->width, *bias = r->row_bias + (size_t)offset * ROWS;
    size_t half = (size_t)LANES * r->width, third = COVARIANCE_ROWS * (size_t)r->width;
    vector lengths = outputs(hidden[COVARIANCE], rows, bias, r->width);
    vector rest = outputs(hidden[COVARIANCE], rows + half, bias + LANES, r->width);
    vector shade = logistic(outputs(hidden[COLOUR], rows + third, bias + COVARIANCE_ROWS, r->width));
    const float quaternion[4] = {lengths[3], rest[0], rest[1], rest[2]};
    vector size = logistic(lengths);
    float *rotation = v->rotation + (size_t)4 * at;
    normalise(quaternion, rotation);
    /* A number that is not finite gives NaN here. */
    float check = quaternion[0] * 0 + quaternion[1] * 0 + quaternion[2] * 0 + quaternion[3] * 0;
    for (int i = 0; i < 3; i++) {
        size_t to = (size_t)3 * at + (size_t)i;
        v->position[to] = mean[i];
        v->scale[to] = axes[i] * size[i];
        v->colour[to] = shade[i];
        check += v->position[to] * 0 + v->scale[to] * 0 + v->colour[to] * 0;
    }
    v->offset[at] = (uint8_t)offset;
    return check == 0;
}

/* SPEC 14.3, GAUSSIANS, for the anchors from `start` to before `end`. Gaussians with a number that is not finite are
 * left out. place: of the camera. number: of the first of all these anchors. room: how many Gaussians there is room for
 * where the pointers say, in the order of `view`.
 *
 * Returns how many there are, or REFUSED for anchors that there are not, or that keep more offsets than there is room.
 */
EXPORT("draw")
int32_t web_draw(const renderer *r, const anchors *a, uint32_t start, uint32_t end, const double *place,
                 uint32_t number, uint32_t room, float *position, float *scale, float *rotation, float *colour,
                 float *opacity, uint32_t *anchor, uint8_t *offsets)
{
    const view v = {position, scale, rotation, colour, opacity, anchor, offsets};
    if (end > a->count || start > end || a->first[end] - a->first[start] > room) return REFUSED;
    float hidden[NETWORKS][RENDER_WIDTH_MAX];
    uint32_t found = 0;
    for (uint32_t i = start; i < end; i++) {
        uint32_t kept = a->first[i + 1] - a->first[i];
        if (kept == 0) continue;
        const uint8_t *offset = a->offset + a->first[i];
        const float *mean = a->mean + (size_t)3 * a->first[i], *sum = a->sum + (size_t)NETWORKS * r->width * i;
        double away[3], square = 0;
        for (int axis = 0; axis < 3; axis++) {
            away[axis] = (double)a->position[(size_t)3 * i + (size_t)axis] - place[axis];
            square += away[axis] * away[axis];
        }
        double distance = sqrt(square);
        vector inputs[PLACE_INPUTS];
        for (int axis = 0; axis < 3; axis++) inputs[axis] = all(distance > 0 ? (float)(away[axis] / distance) : 0);
        inputs[3] = all((float)(distance / (double)r->distance_unit));
        hidden_layer(r, OPACITY, sum, inputs, hidden[OPACITY]);
        int shaped = 0;
        for (uint32_t k = 0; k < kept; k += LANES) {
            const float *row[LANES];
            vector bias;
            for (uint32_t lane = 0; lane < LANES; lane++) {
                uint32_t own = offset[k + lane < kept ? k + lane : kept - 1];
                row[lane] = r->opacity + (size_t)own * r->width;
                bias[lane] = r->opacity_bias[own];
            }
            vector value = products(hidden[OPACITY], row, r->width) + bias;
            vector shown = tangent(value);
            for (uint32_t lane = 0; lane < LANES && k + lane < kept; lane++) {
                if (!(value[lane] > 0)) continue;
                if (!shaped) {
                    for (int n = COVARIANCE; n <= COLOUR; n++) hidden_layer(r, n, sum, inputs, hidden[n]);
                    shaped = 1;
                }
                v.opacity[found] = shown[lane];
                v.anchor[found] = number + i;
                found += (uint32_t)write_gaussian(r, &v, found, mean + (size_t)3 * (k + lane),
                                                  a->axes + (size_t)3 * i, hidden, offset[k + lane]);
            }
        }
    }
    return (int32_t)found;
}
