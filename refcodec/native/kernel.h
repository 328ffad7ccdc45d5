/* The native kernel of refcodec: the process that decides every symbol, in C11.
 *
 * It decodes and encodes the substreams of planes, positions, masks and attributes, and computes float32 values. Its
 * results are those of refcodec/bitstream bit by bit. It needs libc, and pthreads unless KERNEL_THREADS is 0. It uses
 * no files, keeps no global state but constant tables, and frees all that it allocates.
 *
 * The kernel trusts no byte of a file. It trusts its caller in three things: pointers and lengths agree, outputs have
 * room, and networks keep the accumulator bound (SPEC 7.2).
 */
#ifndef REFCODEC_KERNEL_H
#define REFCODEC_KERNEL_H

#include <stdint.h>

#if defined(__GNUC__)
#define KERNEL_API __attribute__((visibility("default")))
#else
#define KERNEL_API
#endif

/* The version of this interface. The binding refuses a library with another one. */
enum { KERNEL_VERSION = 4 };

/* Statuses that are no error codes of SPEC 10.3. */
enum {
    KERNEL_DONE = 0,
    KERNEL_NO_MEMORY = -1,
    /* The caller did not check what it has to: lengths, or symbols that are to be encoded. */
    KERNEL_REFUSED = -2,
    /* What is to be encoded is not allowed: positions that do not have their form, or other step indices. */
    KERNEL_REFUSED_FORM = -3,
    KERNEL_REFUSED_STEPS = -4,
};

enum { KERNEL_SLICES_MAX = 16, KERNEL_PARTS = 3, KERNEL_NUMBERS = 2 };

/* What is made of a substream, or of a chunk. */
typedef struct {
    /* An error code of SPEC 10.3, or a status of this file. */
    int32_t status;
    /* Of a chunk, the part that has the error. */
    int32_t part;
    /* What the text of an error names, by its code:
     *
     * 446: the offsets that are kept. 453: the cells. 454: the first anchor whose cell stands for no fp16.
     * 503: the words that the symbols take. 504: a lane, and its final state. 506: the symbol, and its limit.
     * 507, 508: the raw bits that the symbols take. 509: the CRC-32 of the symbols.
     */
    int64_t number[KERNEL_NUMBERS];
} kernel_verdict;

/* SPEC 5.3 and 5.8: what a scene's symbols are coded with. Weights are those of SPEC 7.2, in file order. */
typedef struct {
    int32_t offset_count, plane_channels, plane_size, frequency_count, plane_shift, slice_count;
    int32_t slice_width[KERNEL_SLICES_MAX];
    /* The layers of F_h, of SARM (0 without planes) and of each network of CARM, output layers included. */
    int32_t hyper_layers, sarm_layers, carm_layers;
    /* The lanes of a substream of planes, of masks and positions, and of attributes. */
    int32_t plane_lanes, mask_lanes, attribute_lanes;
    /* SPEC 5.12: -1 without a model of positions. */
    int32_t cell_shift;
    /* For each layer: outputs, inputs. Then its weights [outputs, inputs], biases and exponents [outputs]. */
    const int32_t *shape;
    const int16_t *weight;
    const int32_t *bias;
    const uint8_t *exponent;
    const uint8_t *carm_shift;
    /* SPEC 5.7: matrix [3, 3], translation, shift, low and high [3] each. NULL without a frame. */
    const int64_t *frame;
    /* SPEC 7.3: the sub-planes [5, channels, size, size]. NULL if only planes are coded. */
    const int16_t *planes;
    /* SPEC 5.11 and 5.12: the model of masks [K (K + 1) / 2], that of positions [18, 16]. NULL if none is needed. */
    const uint16_t *mask_model, *position_model;
} kernel_description;

/* SPEC 5.14: a chunk. Decoding reads the parts and writes the rest. Encoding reads the rest and makes the parts. */
typedef struct {
    /* Positions, masks, attributes. After encoding, each is to be freed with kernel_free. */
    uint8_t *part[KERNEL_PARTS];
    uint64_t length[KERNEL_PARTS];
    /* Numbers of the anchors: float16 bits [n, 3], 0 or 1 [n, K], int32 [n, F], [n, 6], [n, K, 3], uint8 [n, 3]. */
    uint16_t *positions;
    uint8_t *masks;
    int32_t *features, *scalings, *offsets;
    uint8_t *steps;
    uint32_t anchors;
    /* SPEC 5.13: what the entry says. Only decoding reads it. */
    uint32_t kept;
    uint16_t low[3], high[3];
    /* SPEC 5.14: 0 raw or 1 packed. Encoding may be given -1, which packs if it can, and tells the form. */
    int32_t form;
    kernel_verdict verdict;
} kernel_chunk;

typedef struct kernel_tables kernel_tables;
typedef struct kernel_scene kernel_scene;
typedef struct kernel_splatter kernel_splatter;

KERNEL_API int32_t kernel_version(void);
/* The variants that this library has, the best one last, and whether this machine can run one. NULL past the end. */
KERNEL_API const char *kernel_variant_name(int32_t variant);
KERNEL_API int32_t kernel_variant_runs(int32_t variant);

/* SPEC A: the tables of the shipped file. Returns NULL without memory, or if they are not such tables. */
KERNEL_API kernel_tables *kernel_tables_new(const uint8_t *file, uint64_t length);
KERNEL_API void kernel_tables_free(kernel_tables *tables);
/* Returns NULL without memory, or if a number is outside SPEC 11.1. The tables must stay as long as the scene. */
KERNEL_API kernel_scene *kernel_scene_new(const kernel_description *description, const kernel_tables *tables,
                                          int32_t variant);
KERNEL_API void kernel_scene_free(kernel_scene *scene);

/* SPEC 7.13, DECODE_WEIGHTS: decodes `few` symbols of the Laplacian family, then `many` of the Gaussian one.
 *
 * scale: uint8 [few + many], each less SCALE_MIN and at most 255. symbols: [few + many].
 */
KERNEL_API void kernel_decode_weights(const kernel_tables *tables, int32_t variant, const uint8_t *part,
                                      uint64_t length, int32_t lanes, const uint8_t *scale, uint64_t few,
                                      uint64_t many, int32_t *symbols, kernel_verdict *verdict);
/* SPEC 7.3: decodes the five substreams of planes to int16 [5, channels, size, size]. verdict: [5]. */
KERNEL_API void kernel_decode_planes(const kernel_scene *scene, const uint8_t *const *part, const uint64_t *length,
                                     int16_t *planes, kernel_verdict *verdict, int32_t threads);
/* The reverse. The parts are to be freed with kernel_free. */
KERNEL_API void kernel_encode_planes(const kernel_scene *scene, const int16_t *planes, uint8_t **part,
                                     uint64_t *length, kernel_verdict *verdict, int32_t threads);
KERNEL_API void kernel_decode_chunks(const kernel_scene *scene, kernel_chunk *chunks, int64_t count, int32_t threads);
KERNEL_API void kernel_encode_chunks(const kernel_scene *scene, kernel_chunk *chunks, int64_t count, int32_t threads);
KERNEL_API void kernel_free(void *memory);

/* SPEC 9.2: values[i, j] = symbols[i, j] * step[index[i * stride]], rows by width. step: float32 [64]. */
KERNEL_API void kernel_values(int32_t variant, const int32_t *symbols, const uint8_t *index, int64_t stride,
                              const float *step, int64_t rows, int64_t width, float *values);

/* The rendering networks of a static scene (SPEC 9.4), to be freed with kernel_free. colours: the outputs of the colour
 * network for an offset. weight, bias, exponent: of all layers in file order, as DERIVE_ROW gives them.
 *
 * Returns NULL without memory, or for numbers outside SPEC 11.1.
 */
KERNEL_API kernel_splatter *kernel_splatter_new(int32_t variant, uint32_t features, uint32_t width, uint32_t offsets,
                                                uint32_t colours, const int16_t *weight, const int32_t *bias,
                                                const uint8_t *exponent);
/* SPEC 9.4, SPLAT. mean, length, quaternion, logit, harmonic: where the numbers of the first Gaussian go. stride: from
 * the numbers of one Gaussian to those of the next, or 0 if each array has them without gaps. room: in Gaussians.
 * steps: NULL, or uint8 [count, 3]: feature, scaling and offset are symbols then, int32, and step is [3, 64].
 *
 * Returns the number of Gaussians, KERNEL_REFUSED if they do not fit, or KERNEL_NO_MEMORY.
 */
KERNEL_API int32_t kernel_splat(const kernel_splatter *splatter, uint32_t count, const float *position,
                                const uint8_t *mask, const void *feature, const void *scaling, const void *offset,
                                const uint8_t *steps, const float *step, uint32_t room, uint32_t stride, float *mean,
                                float *length, float *quaternion, float *logit, float *harmonic, int32_t threads);

#endif
