/* The native kernel for WebAssembly: kernel.c with the tables, packed weights and world positions.
 *
 * The functions take plain numbers and pointers, so that kernel.js knows no layout of kernel.h. JavaScript has parsed
 * and checked what comes before a substream. package.json has the command that builds it.
 */
#define KERNEL_THREADS 0
#include "../native/kernel.c"

#include <stddef.h>

#include "../native/module.h"

enum { NUMBERS = 6 + KERNEL_SLICES_MAX + 7 };

/* Annex A. */
static const uint8_t file[] = {
#embed "../data/tables-0.bin"
};
static kernel_tables *tables;

/* The best variant. */
enum { VARIANT_USED = VARIANTS - 1 };

EXPORT("allocate") void *web_allocate(uint32_t size) { return malloc(size ? size : 1); }
EXPORT("release") void web_release(void *memory) { free(memory); }

/* Makes the tables. Returns the shipped file of tables, or NULL without memory. */
EXPORT("start") const uint8_t *web_start(void)
{
    tables = kernel_tables_new(file, sizeof file);
    return tables ? file : NULL;
}

/* ------------------------------------------------------------------------------------ SPEC 7.13: packed weights -- */

/* SPEC 7.13, DECODE_WEIGHTS: decodes `few` and then `many` symbols. scale: as above. Returns a code or a status. */
EXPORT("decodeWeights")
int32_t web_decode_weights(const uint8_t *part, uint32_t length, int32_t lanes, const uint8_t *scale, uint32_t few,
                           uint32_t many, int32_t *to)
{
    kernel_verdict verdict;
    kernel_decode_weights(tables, VARIANT_USED, part, length, lanes, scale, few, many, to, &verdict);
    return verdict.status;
}

/* --------------------------------------------------------------------------------------------- planes and chunks -- */

/* numbers: the first fields of kernel_description, in its order. The rest is as there. Returns NULL without memory. */
EXPORT("makeScene")
kernel_scene *web_make_scene(const int32_t *numbers, const int32_t *shape, const int16_t *weight, const int32_t *bias,
                             const uint8_t *exponent, const uint8_t *carm_shift, const int64_t *frame,
                             const int16_t *planes, const uint16_t *mask_model, const uint16_t *position_model)
{
    kernel_description d = {.shape = shape, .weight = weight, .bias = bias, .exponent = exponent,
                            .carm_shift = carm_shift, .frame = frame, .planes = planes, .mask_model = mask_model,
                            .position_model = position_model};
    _Static_assert(offsetof(kernel_description, shape) == 4 * NUMBERS, "kernel.js writes these numbers");
    memcpy(&d, numbers, 4 * NUMBERS);
    return kernel_scene_new(&d, tables, VARIANT_USED);
}

EXPORT("freeScene") void web_free_scene(kernel_scene *scene) { kernel_scene_free(scene); }

/* SPEC 7.3. place: where each of the five substreams starts in `bytes`, and then their lengths. status: [5]. */
EXPORT("decodePlanes")
void web_decode_planes(const kernel_scene *scene, const uint8_t *bytes, const uint32_t *place, int16_t *planes,
                       int32_t *status)
{
    const uint8_t *part[PLANES];
    uint64_t length[PLANES];
    kernel_verdict verdict[PLANES];
    for (int i = 0; i < PLANES; i++) {
        part[i] = bytes + place[i];
        length[i] = place[PLANES + i];
    }
    kernel_decode_planes(scene, part, length, planes, verdict, 1);
    for (int i = 0; i < PLANES; i++) status[i] = verdict[i].status;
}

/* SPEC 10.1, CHUNKS. place: where each part starts in `bytes`, and then their lengths. bounds: low and high, [6].
 *
 * failed: the part that has the error.
 */
EXPORT("decodeChunk")
int32_t web_decode_chunk(const kernel_scene *scene, const uint8_t *bytes, const uint32_t *place, int32_t form,
                         uint32_t anchors, uint32_t kept, const uint16_t *bounds, uint16_t *positions, uint8_t *masks,
                         int32_t *features, int32_t *scalings, int32_t *offsets, uint8_t *steps, int32_t *failed)
{
    kernel_chunk c = {.positions = positions, .masks = masks, .features = features, .scalings = scalings,
                      .offsets = offsets, .steps = steps, .anchors = anchors, .kept = kept, .form = form};
    for (int i = 0; i < KERNEL_PARTS; i++) {
        c.part[i] = (uint8_t *)bytes + place[i];
        c.length[i] = place[KERNEL_PARTS + i];
    }
    memcpy(c.low, bounds, sizeof c.low);
    memcpy(c.high, bounds + 3, sizeof c.high);
    kernel_decode_chunks(scene, &c, 1, 1);
    *failed = c.verdict.part;
    return c.verdict.status;
}

/* ---------------------------------------------------------------------------------------- SPEC 9: reconstruction -- */

/* SPEC 9.1, WORLD. positions: [n, 3]. unit: 2^(scale_exponent - 24). Results are 0 or normal, so scaling is exact. */
EXPORT("worldPositions")
void web_world_positions(const uint16_t *positions, uint32_t n, const int64_t *origin, int32_t mantissa, float unit,
                         float *to)
{
    for (uint32_t i = 0; i < 3 * n; i++)
        to[i] = (float)(origin[i % 3] + mantissa * position_integer(positions[i])) * unit;
}

/* SPEC 9.2, VALUE. steps: of the kind, each KINDS bytes behind the one before. step: [STEP_LENGTH]. */
EXPORT("attributeValues")
void web_values(const int32_t *symbols, const uint8_t *steps, const float *step, uint32_t rows, uint32_t width,
                float *to)
{
    kernel_values(VARIANT_USED, symbols, steps, KINDS, step, rows, width, to);
}
