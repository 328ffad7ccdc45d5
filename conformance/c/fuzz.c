/* A target of libFuzzer: the decoder in C, and the native kernel beside it.
 *
 * An input is a file. The decoder decodes it as DECODE_FILE does. The kernel gets what the decoder has checked, and
 * must have the same verdict on each substream and chunk, the same values and the same Gaussians, and encode the chunk
 * as it was. All arrays have exactly their size, so that a sanitizer sees each access outside.
 *
 * The mutator changes a part of a file, keeps lengths right and repairs the CRC-32s, so that changes reach later
 * checks. C3GS_TABLES names the tables. With REPLAY defined it is a program that runs the files of its arguments, for a
 * compiler without libFuzzer.
 *
 *    clang -std=gnu11 -g -O1 -ffp-contract=off -fno-math-errno -DKERNEL_THREADS=0 -fsanitize=fuzzer,address,undefined
 *      -fno-sanitize-recover=all conformance/c/fuzz.c refcodec/native/kernel.c refcodec/native/splat.c -lm -o fuzz
 */
#define _XOPEN_SOURCE 700
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>

_Noreturn static void LEAVE(int status);
static FILE *said;
#define exit LEAVE
#undef stderr
#define stderr said
#define main decoder_main
#include "decoder.c"
#undef main
#undef exit

#include "../../refcodec/native/kernel.h"

/* Longer decoding is not tried: 11.2 allows hours. */
#define WORK_MAX (UINT64_C(1) << 27)

static kernel_tables *tables;
static jmp_buf end;
static int running;
static char text[128]; /* of an error */

_Noreturn static void LEAVE(int status)
{
    if (!running || status == STATUS_USAGE) {
        fflush(said);
        puts(text);
        abort();
    }
    longjmp(end, 1);
}

#define CHECK(condition)                                                                                               \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            printf("fuzz.c:%d: not so: %s\n", __LINE__, #condition);                                                   \
            fflush(stdout);                                                                                            \
            abort();                                                                                                   \
        }                                                                                                              \
    } while (0)

/* ---------------------------------------------------------------- the kernel beside the decoder */

static struct {
    kernel_scene *scene;
    kernel_splatter *splatter;
    int32_t variant, weights, planes[5]; /* statuses */
    kernel_chunk chunk;
} kernel;

static void *BLOCK(uint64_t count, uint64_t size)
{
    void *block = calloc(1, (size_t)(count * size));
    CHECK(block || !count || !size);
    return block;
}

static uint8_t *COPY(const uint8_t *p, uint64_t n)
{
    uint8_t *copy = BLOCK(n, 1);
    if (n)
        memcpy(copy, p, (size_t)n);
    return copy;
}

/* The weights, biases and exponents of the networks from `first` to `last` in one array each */
struct layers {
    int32_t *shape, *bias;
    int16_t *weight;
    uint8_t *exponent;
};

static struct layers JOIN(const struct network *n, int first, int last)
{
    uint64_t count = WEIGHT_COUNT(n, first, last), rows = 0, weights = 0, layers = 0;
    struct layers all = {BLOCK(2 * count, 4), BLOCK(count, 4), BLOCK(count, 2), BLOCK(count, 1)};
    for (int i = first; i < last; i++)
        for (uint32_t k = 0; k < LAYERS(&n[i]); k++) {
            const struct layer *l = &n[i].layer[k];
            uint64_t own = (uint64_t)l->outputs * l->inputs;
            all.shape[2 * layers] = (int32_t)l->outputs;
            all.shape[2 * layers++ + 1] = (int32_t)l->inputs;
            memcpy(all.weight + weights, l->weight, 2 * own);
            memcpy(all.bias + rows, l->bias, 4 * l->outputs);
            memcpy(all.exponent + rows, l->exponent, l->outputs);
            weights += own;
            rows += l->outputs;
        }
    return all;
}

static void FREE_LAYERS(struct layers all)
{
    free(all.shape);
    free(all.bias);
    free(all.weight);
    free(all.exponent);
}

/* whole: whether with planes and models, for chunks */
static void MAKE_SCENE(const struct scene *s, int whole)
{
    const struct header *h = &s->h;
    struct layers all = JOIN(s->networks, HYPER, OPACITY);
    uint64_t points = whole ? (uint64_t)h->plane_channels * h->plane_size * h->plane_size : 0;
    uint32_t masks = h->offset_count * (h->offset_count + 1u) / 2;
    int16_t *planes = BLOCK(5 * points, 2);
    uint16_t *models = BLOCK(masks, 2), *cells = BLOCK(POSITION_MODELS, 32);
    int64_t frame[21];
    kernel_description d = {.offset_count = h->offset_count, .plane_channels = h->plane_channels,
                            .plane_size = (int32_t)h->plane_size, .frequency_count = h->frequency_count,
                            .plane_shift = (int32_t)s->plane_shift, .slice_count = h->slice_width.count,
                            .hyper_layers = h->hyper_width.count + 1,
                            .sarm_layers = h->plane_channels ? h->sarm_width.count + 1 : 0,
                            .carm_layers = h->carm_width.count + 1, .plane_lanes = 1 << h->lanes_log2[0],
                            .mask_lanes = 1 << h->lanes_log2[1], .attribute_lanes = 1 << h->lanes_log2[2],
                            .cell_shift = whole && s->packed ? (int32_t)s->cell_shift : -1, .shape = all.shape,
                            .weight = all.weight, .bias = all.bias, .exponent = all.exponent,
                            .carm_shift = s->carm_shift, .planes = whole ? planes : NULL,
                            .mask_model = whole ? models : NULL, .position_model = whole && s->packed ? cells : NULL};
    for (int i = 0; i < h->slice_width.count; i++)
        d.slice_width[i] = h->slice_width.item[i];
    if (h->plane_channels || h->frequency_count) {
        for (int i = 0; i < 9; i++)
            frame[i] = s->frame.matrix[i];
        for (int i = 0; i < 3; i++) {
            frame[9 + i] = s->frame.translation[i];
            frame[12 + i] = s->frame.shift[i];
            frame[15 + i] = s->frame.low[i];
            frame[18 + i] = s->frame.high[i];
        }
        d.frame = frame;
    }
    for (int i = 0; points && i < 5; i++)
        memcpy(planes + (uint64_t)i * points, s->plane[i], 2 * points);
    for (uint32_t i = 0; i < masks; i++)
        models[i] = (uint16_t)s->mask_model[i];
    memcpy(cells, s->position_model, sizeof s->position_model);
    kernel_scene_free(kernel.scene);
    kernel.scene = kernel_scene_new(&d, tables, kernel.variant);
    CHECK(kernel.scene);
    FREE_LAYERS(all);
    free(planes);
    free(models);
    free(cells);
    if (whole && h->render_model == STATIC) {
        all = JOIN(s->networks, OPACITY, NETWORKS);
        kernel.splatter = kernel_splatter_new(h->features, h->render_width, h->offset_count, h->colour_outputs,
                                              all.weight, all.bias, all.exponent);
        CHECK(kernel.splatter);
        FREE_LAYERS(all);
    }
}

/* Of packed weights, before the decoder decodes them. It refuses a wrong LayerModel here. */
static void KERNEL_WEIGHTS(struct scene *s, struct piece p)
{
    uint64_t at = PAD4(2u + s->h.features - s->h.slice_width.item[s->h.slice_width.count - 1]), few = 0, many = 0;
    uint8_t *scale, *stream;
    int32_t *symbols;
    kernel_verdict verdict;
    if (p.length < at)
        return;
    at = LAYER_MODELS(s, p, at);
    scale = BLOCK(2 * WEIGHT_COUNT(s->networks, 0, NETWORKS), 1);
    for (int kind = 0; kind < 2; kind++)
        for (int i = 0; i < NETWORKS; i++)
            for (uint32_t k = 0; k < LAYERS(&s->networks[i]); k++) {
                const struct layer *l = &s->networks[i].layer[k];
                uint64_t count = l->raw_at ? 0 : kind ? (uint64_t)l->outputs * l->inputs : 2 * l->outputs;
                for (uint64_t n = 0; n < count; n++)
                    scale[few + many + n] = l->model[kind ? 4 : n < l->outputs ? 1 : 5];
                *(kind ? &many : &few) += count;
            }
    scale = realloc(scale, few + many + 1);
    CHECK(scale);
    symbols = BLOCK(few + many, 4);
    stream = COPY(p.data + at, p.length - at);
    kernel_decode_weights(tables, kernel.variant, stream, p.length - at, 1 << s->h.lanes_log2[2], scale, few, many,
                          symbols, &verdict);
    kernel.weights = verdict.status;
    free(stream);
    free(scale);
    free(symbols);
}

/* Of planes, if their lengths are right. What is decoded is encoded again. */
static void KERNEL_PLANES(struct scene *s, struct piece p)
{
    uint64_t sum = PLANE_TABLE_LENGTH, length[5], made_length[5], at = PLANE_TABLE_LENGTH;
    uint8_t *part[5], *made[5];
    const uint8_t *given[5];
    int16_t *planes;
    kernel_verdict verdict[5];
    int right = 1;
    for (int i = 0; i < 5 && p.length >= PLANE_TABLE_LENGTH; i++)
        sum += PAD4(length[i] = GET_U32(p.data + 4 * i));
    if (p.length < PLANE_TABLE_LENGTH || sum != p.length)
        return;
    MAKE_SCENE(s, 0);
    for (int i = 0; i < 5; at += PAD4(length[i]), i++)
        given[i] = part[i] = COPY(p.data + at, length[i]);
    planes = BLOCK(5 * (uint64_t)s->h.plane_channels * s->h.plane_size * s->h.plane_size, 2);
    kernel_decode_planes(kernel.scene, given, length, planes, verdict, 1);
    for (int i = 0; i < 5; i++)
        right = right && !(kernel.planes[i] = verdict[i].status);
    if (right)
        kernel_encode_planes(kernel.scene, planes, made, made_length, verdict, 1);
    for (int i = 0; i < 5; i++) {
        if (right) {
            CHECK(!verdict[i].status && made_length[i] == length[i] && !memcmp(made[i], part[i], length[i]));
            kernel_free(made[i]);
        }
        free(part[i]);
    }
    free(planes);
}

static void FREE_CHUNK(kernel_chunk *c)
{
    for (int i = 0; i < KERNEL_PARTS; i++)
        free(c->part[i]);
    free(c->positions);
    free(c->masks);
    free(c->features);
    free(c->scalings);
    free(c->offsets);
    free(c->steps);
    memset(c, 0, sizeof *c);
}

/* Of a chunk whose parts have right lengths. The result is the status. */
static int32_t KERNEL_CHUNK(const struct scene *s, const struct chunk *from, const uint8_t *bytes)
{
    uint64_t n = from->anchors, k = s->h.offset_count, at = CHUNK_HEAD_LENGTH;
    kernel_chunk *c = &kernel.chunk, again;
    for (int i = 0; i < KERNEL_PARTS; i++) {
        c->length[i] = GET_U32(bytes + 4 * i);
        c->part[i] = COPY(bytes + at, c->length[i]);
        at += PAD4(c->length[i]);
    }
    c->positions = BLOCK(3 * n, 2);
    c->masks = BLOCK(k * n, 1);
    c->features = BLOCK(s->h.features * n, 4);
    c->scalings = BLOCK(6 * n, 4);
    c->offsets = BLOCK(3 * k * n, 4);
    c->steps = BLOCK(3 * n, 1);
    c->anchors = from->anchors;
    c->kept = from->kept;
    c->form = bytes[12];
    for (int a = 0; a < 3; a++) {
        c->low[a] = (uint16_t)from->low[a];
        c->high[a] = (uint16_t)from->high[a];
    }
    kernel_decode_chunks(kernel.scene, c, 1, 1);
    if (c->verdict.status)
        return c->verdict.status;
    again = *c;
    kernel_encode_chunks(kernel.scene, &again, 1, 1);
    CHECK(!again.verdict.status && again.form == c->form);
    for (int i = 0; i < KERNEL_PARTS; i++) {
        CHECK(again.length[i] == c->length[i] && !memcmp(again.part[i], c->part[i], c->length[i]));
        kernel_free(again.part[i]);
    }
    return KERNEL_DONE;
}

/* Adds numbers as PUT_U32 writes them: 9.3. The machine is little-endian. */
static void ADD(struct part *part, const float *numbers, uint64_t count)
{
    SHA_ADD(&part->digest, (const uint8_t *)numbers, 4 * count);
}

/* 9: what the kernel makes of the chunk */
static void KERNEL_VALUES(const struct scene *s, struct part *part)
{
    const kernel_chunk *c = &kernel.chunk;
    const int32_t *symbols[3] = {c->features, c->scalings, c->offsets};
    uint64_t n = c->anchors, k = s->h.offset_count, row = 11 + s->h.colour_outputs;
    const uint64_t width[3] = {s->h.features, 6, 3 * k};
    float *values[3], *positions = BLOCK(3 * n, 4), *splats = BLOCK(row * c->kept, 4);
    for (int a = 0; a < 3; a++) {
        float steps[STEP_LENGTH];
        memcpy(steps, s->step[a], sizeof steps);
        values[a] = BLOCK(width[a] * n, 4);
        kernel_values(kernel.variant, symbols[a], c->steps + a, 3, steps, (int64_t)n, (int64_t)width[a], values[a]);
        ADD(&part[FEATURES + a], values[a], width[a] * n);
    }
    for (uint64_t i = 0; i < 3 * n; i++)
        positions[i] = F32(WORLD(&s->h, i % 3, c->positions[i]));
    ADD(&part[POSITIONS], positions, 3 * n);
    SHA_ADD(&part[MASKS].digest, c->masks, n * k);
    if (kernel.splatter) {
        int32_t count = kernel_splat(kernel.splatter, c->anchors, positions, c->masks, values[0], values[1], values[2],
                                     c->kept, (uint32_t)row, splats, splats + 3, splats + 6, splats + 10, splats + 11);
        CHECK(count == (int32_t)c->kept);
        ADD(&part[SPLATS], splats, row * c->kept);
    }
    for (int a = 0; a < 3; a++)
        free(values[a]);
    free(positions);
    free(splats);
}

/* ---------------------------------------------------------------- an input */

static struct scene s;
static enum section at_section; /* that is decoded, or ANCILLARY */
static uint64_t entries_at, data_at; /* the offsets of the first ChunkEntry and of DATA */

/* DECODE_FILE up to the digests, with the kernel beside it. The result is 0 if the file needs too much work. */
static int DECODE(void)
{
    struct header *h = &s.h;
    uint64_t data_length = 0;
    PROLOGUE(h, &s.section);
    HEADER_FIELDS(h, &s.section);
    HEADER(h, s.networks);
    if (WORK(h, s.networks) > WORK_MAX)
        return 0;
    DIRECTORY(h, s.networks);
    PARTS_BEGIN(&s);
    for (uint32_t i = 0; i < h->section_count; i++)
        if (h->directory[i].section == DATA)
            data_length = h->directory[i].length;
    for (uint32_t i = 0; i < h->section_count; i++) {
        const struct entry *e = &h->directory[i];
        struct piece p;
        at_section = e->section;
        switch (e->section) {
        case FRAM:
            FRAME(&s, SECTION(e, &s.section));
            break;
        case WGTS:
            p = SECTION(e, &s.section);
            if (e->mode)
                KERNEL_WEIGHTS(&s, p);
            READ_WEIGHTS(&s, p, e->mode);
            break;
        case PLNS:
            p = SECTION(e, &s.section);
            KERNEL_PLANES(&s, p);
            READ_PLANES(&s, p);
            JOIN_QUADRANTS(&s);
            break;
        case INDX:
            p = SECTION(e, &s.index);
            READ_INDEX(&s, p, e->mode, data_length);
            entries_at = p.at + (uint64_t)(s.entries - p.data);
            break;
        case DATA:
            data_at = input_at;
            MAKE_SCENE(&s, 1);
            CHUNKS(&s, e);
            break;
        default:
            SKIP_SECTION(e, &s.section);
        }
    }
    at_section = ANCILLARY;
    if (READ(&s.section, 1).length)
        REFUSE(FILE_TRAILING, input_at - 1);
    return 1;
}

/* Whether the kernel decides this error. Its caller finds those before in 10.1. */
static int IS_OF_KERNEL(int code) { return code >= CHUNK_KEPT && code <= SUBSTREAM_SYMBOL_CRC; }

/* The chunks once more, by the kernel. code: the decoder's verdict. refused_at: the offset if it is of DATA. */
static void COMPARE_CHUNKS(const uint8_t *data, uint64_t size, int code, uint64_t refused_at)
{
    struct part own[PARTS];
    uint64_t at = data_at;
    for (int i = 0; i < PARTS; i++)
        SHA_START(&own[i].digest);
    for (uint32_t i = 0; i < s.h.chunk_count; i++) {
        struct chunk c;
        int32_t status;
        ENTRY(data + entries_at, i, &c);
        if (at_section == DATA && code && refused_at < at + c.length && !IS_OF_KERNEL(code))
            return; /* it may not be whole */
        CHECK(c.length <= size - at);
        status = KERNEL_CHUNK(&s, &c, data + at);
        if (at_section == DATA && code && refused_at < at + c.length) {
            CHECK(status == code);
            return;
        }
        CHECK(!status);
        KERNEL_VALUES(&s, own);
        FREE_CHUNK(&kernel.chunk);
        at += c.length;
    }
    for (int i = 0; !code && i < PARTS; i++) {
        uint8_t digest[2][32];
        if (i == PLANES || i == WEIGHTS || (i == SPLATS && !kernel.splatter))
            continue;
        SHA_END(&s.part[i].digest, digest[0]);
        SHA_END(&own[i].digest, digest[1]);
        CHECK(!memcmp(digest[0], digest[1], 32));
    }
}

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t room, unsigned seed);

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    struct buffer b = {NULL, 0};
    struct piece p;
    (void)argc;
    said = fmemopen(text, sizeof text, "w");
    CHECK(said && getenv("C3GS_TABLES"));
    MAKE_CRC_TABLE();
    LOAD_TABLES(**argv, &b);
    input = fopen(getenv("C3GS_TABLES"), "rb");
    p = READ(&b, TABLES_LENGTH);
    tables = kernel_tables_new(p.data, p.length);
    CHECK(tables);
    RELEASE();
    return 0;
}

/* The decoder's verdict: 0, a code, or -1 if the file needs too much work. refused_at: the offset of the error. */
static int DECODE_INPUT(const uint8_t *data, size_t size, unsigned long long *refused_at)
{
    volatile int verdict = 0; /* setjmp returns twice */
    int32_t variants = 1, code = 0;
    while (kernel_variant_name(variants) && kernel_variant_runs(variants))
        variants++;
    memset(&s, 0, sizeof s);
    memset(&kernel, 0, sizeof kernel);
    kernel.variant = (int32_t)(CRC32(0, data, size) % (uint32_t)variants);
    at_section = ANCILLARY;
    input_at = data_at = probed = 0;
    rewind(said);
    input = size ? fmemopen((void *)(uintptr_t)data, size, "rb") : fopen("/dev/null", "rb");
    CHECK(input);
    running = 1;
    if (!setjmp(end)) {
        verdict = DECODE() ? 0 : -1;
    } else {
        fflush(said);
        CHECK(sscanf(text, "{\"code\": %d, \"name\": \"%*[a-z_.]\", \"offset\": %llu}", &code, refused_at) == 2);
        verdict = code;
    }
    running = 0;
    return verdict;
}

static void RELEASE_ALL(void)
{
    FREE_CHUNK(&kernel.chunk);
    kernel_scene_free(kernel.scene);
    kernel_free(kernel.splatter);
    RELEASE();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    unsigned long long refused_at = 0;
    int code, first = 0;
    /* the probes of some files */
    probes = size && data[size - 1] & 1 ? fopen("/dev/null", "wb") : NULL;
    code = DECODE_INPUT(data, size, &refused_at);
    if (probes)
        fclose(probes);
    probes = NULL;
    for (int i = 0; i < 5 && !first; i++)
        first = kernel.planes[i];
    CHECK(at_section != WGTS || !IS_OF_KERNEL(code) || kernel.weights == code);
    CHECK(!kernel.weights || (at_section == WGTS && code));
    CHECK(at_section != PLNS || !IS_OF_KERNEL(code) || first == code);
    CHECK(!first || (at_section == PLNS && code));
    if (data_at)
        COMPARE_CHUNKS(data, size, code, refused_at);
    RELEASE_ALL();
    return code < 0 ? -1 : 0;
}

/* ---------------------------------------------------------------- the mutator */

size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t room);

/* A part of a file, and the lengths that count it: a u32 of its own, a ChunkEntry's u32, a directory entry's u64. They
   are offsets, or 0. A part without any keeps its length. */
struct place {
    uint64_t at, length, own, chunk, section;
};
enum { PLACES = 64 };

/* The header's end and the directory's begin, or 0 if they are not in the file. Nothing is checked. */
static uint64_t DIRECTORY_AT(const uint8_t *d, uint64_t size)
{
    uint64_t stop = size < PROLOGUE_LENGTH ? 0 : PROLOGUE_LENGTH + (uint64_t)GET_U32(d + 12), at;
    if (stop > size || stop < PROLOGUE_LENGTH + FIXED_LENGTH)
        return 0;
    at = PAD4(PROLOGUE_LENGTH + FIXED_LENGTH + d[AT_SLICE_COUNT] +
              2u * (d[AT_HYPER_LAYERS] + d[AT_SARM_LAYERS] + d[AT_CARM_LAYERS]));
    return at + DIRECTORY_ENTRY_LENGTH * (uint64_t)GET_U16(d + AT_SECTION_COUNT) + 4 <= stop ? at : 0;
}

/* Writes the places of a file, as far as it is whole, and repairs its CRC-32s if `repair`. Returns their number. */
static int PLACES_OF(uint8_t *d, uint64_t size, struct place *to, int repair)
{
    uint64_t directory = DIRECTORY_AT(d, size), at, index = 0, index_length = 0;
    int count = 0;
    if (!directory)
        return 0;
    at = PROLOGUE_LENGTH + GET_U32(d + 12);
    to[count++] = (struct place){PROLOGUE_LENGTH, at - PROLOGUE_LENGTH, 0, 0, 0};
    for (uint32_t i = 0; i < GET_U16(d + AT_SECTION_COUNT); i++) {
        uint8_t *e = d + directory + DIRECTORY_ENTRY_LENGTH * (uint64_t)i;
        uint64_t length = GET_U64(e + 8), length_at = (uint64_t)(e + 8 - d);
        if (length > size - at)
            break;
        if (!memcmp(e, "INDX", 4)) {
            index = at + PAD4(d[AT_OFFSET_COUNT] * (d[AT_OFFSET_COUNT] + 1u)) + (e[4] ? POSITION_MODEL_LENGTH : 0);
            index_length = at + length;
        }
        if (!memcmp(e, "PLNS", 4) && length >= PLANE_TABLE_LENGTH)
            for (uint64_t k = 0, from = at + PLANE_TABLE_LENGTH; k < 5; k++) {
                uint64_t own = GET_U32(d + at + 4 * k);
                if (PAD4(own) > at + length - from)
                    break;
                if (count < PLACES)
                    to[count++] = (struct place){from, own, at + 4 * k, 0, length_at};
                from += PAD4(own);
            }
        else if (!memcmp(e, "DATA", 4) && index)
            for (uint64_t chunk = at; index + CHUNK_ENTRY_LENGTH <= index_length; index += CHUNK_ENTRY_LENGTH) {
                uint64_t own = GET_U32(d + index), from = chunk + CHUNK_HEAD_LENGTH;
                if (own < CHUNK_HEAD_LENGTH || own > at + length - chunk)
                    break;
                for (uint64_t k = 0; k < 3; k++) {
                    uint64_t part = GET_U32(d + chunk + 4 * k);
                    if (PAD4(part) > chunk + own - from)
                        break;
                    if (count < PLACES)
                        to[count++] = (struct place){from, part, chunk + 4 * k, index, length_at};
                    from += PAD4(part);
                }
                if (repair)
                    PUT_U32(d + index + 4, CRC32(0, d + chunk, own));
                chunk += own;
            }
        else if (count < PLACES)
            to[count++] = (struct place){at, length, 0, 0, memcmp(e, "WGTS", 4) ? 0 : length_at};
        at += PAD4(length) < size - at ? PAD4(length) : size - at;
    }
    if (!repair)
        return count;
    at = PROLOGUE_LENGTH + GET_U32(d + 12);
    for (uint32_t i = 0; i < GET_U16(d + AT_SECTION_COUNT); i++) {
        uint8_t *e = d + directory + DIRECTORY_ENTRY_LENGTH * (uint64_t)i;
        uint64_t length = GET_U64(e + 8);
        if (length > size - at)
            break;
        if (memcmp(e, "DATA", 4))
            PUT_U32(e + 16, CRC32(0, d + at, length));
        at += PAD4(length) < size - at ? PAD4(length) : size - at;
    }
    at = PROLOGUE_LENGTH + GET_U32(d + 12) - 4;
    PUT_U32(d + at, CRC32(0, d + PROLOGUE_LENGTH, at - PROLOGUE_LENGTH));
    PUT_U32(d + 16, CRC32(0, d, 16));
    return count;
}

/* Puts other bytes in a place. The result is the file's size. */
static uint64_t PUT(uint8_t *d, uint64_t size, uint64_t room, struct place p, const uint8_t *bytes, uint64_t length)
{
    uint64_t before = PAD4(p.length), after = PAD4(length), tail = size - p.at - before;
    if (!p.section) {
        memcpy(d + p.at, bytes, length < p.length ? length : p.length);
        return size;
    }
    if (p.at + after + tail > room)
        return size;
    memmove(d + p.at + after, d + p.at + before, tail);
    memcpy(d + p.at, bytes, length);
    memset(d + p.at + length, 0, after - length);
    if (p.own)
        PUT_U32(d + p.own, (uint32_t)length);
    if (p.chunk)
        PUT_U32(d + p.chunk, (uint32_t)(GET_U32(d + p.chunk) + after - before));
    /* Only substreams are padded within their section. Sections are below 4 GiB here. */
    PUT_U32(d + p.section, (uint32_t)(GET_U32(d + p.section) + (p.own ? after - before : length - p.length)));
    return p.at + after + tail;
}

/* Changes the bytes of a place. */
static uint64_t CHANGE(uint8_t *d, uint64_t size, uint64_t room, struct place p)
{
    uint64_t most = p.section ? p.length + 64 : p.length, length;
    uint8_t *bytes;
    if (PAD4(p.length) > size - p.at || !most)
        return LLVMFuzzerMutate(d, size, room);
    bytes = BLOCK(most, 1);
    memcpy(bytes, d + p.at, p.length);
    length = LLVMFuzzerMutate(bytes, p.length, most);
    size = PUT(d, size, room, p, bytes, length);
    free(bytes);
    return size;
}

static void LIMIT(int32_t *symbols, uint64_t count)
{
    LLVMFuzzerMutate((uint8_t *)symbols, 4 * count, 4 * count);
    for (uint64_t i = 0; i < count; i++)
        symbols[i] = (int32_t)CLAMP(symbols[i], -ATTRIBUTE_SYMBOL_MAX, ATTRIBUTE_SYMBOL_MAX);
}

/* Changes symbols of a chunk of a valid file, and encodes it again. Other files stay as they are. */
static uint64_t CHANGE_SYMBOLS(uint8_t *d, uint64_t size, uint64_t room, uint32_t r)
{
    struct place places[PLACES];
    unsigned long long refused_at;
    struct chunk c;
    kernel_chunk *k = &kernel.chunk, made;
    uint64_t at, offsets;
    uint32_t number;
    int first = 0, count;
    if (DECODE_INPUT(d, size, &refused_at) || !s.h.chunk_count)
        goto done;
    number = r % s.h.chunk_count;
    at = data_at;
    for (uint32_t i = 0; i < number; i++)
        at += GET_U32(d + entries_at + CHUNK_ENTRY_LENGTH * (uint64_t)i);
    ENTRY(d + entries_at, number, &c);
    CHECK(!KERNEL_CHUNK(&s, &c, d + at));
    offsets = (uint64_t)s.h.offset_count * c.anchors;
    if (r >> 16 & 1)
        LLVMFuzzerMutate(k->masks, offsets, offsets);
    LIMIT(k->features, (uint64_t)s.h.features * c.anchors);
    LIMIT(k->scalings, 6 * (uint64_t)c.anchors);
    LIMIT(k->offsets, 3 * offsets);
    c.kept = 0;
    for (uint64_t i = 0; i < offsets; i++) {
        c.kept += k->masks[i] &= 1;
        for (uint64_t j = 3 * i; !k->masks[i] && j < 3 * i + 3; j++)
            k->offsets[j] = 0;
    }
    made = *k;
    kernel_encode_chunks(kernel.scene, &made, 1, 1);
    CHECK(!made.verdict.status);
    PUT_U32(d + entries_at + CHUNK_ENTRY_LENGTH * (uint64_t)number + 12, c.kept);
    /* Attributes first: the places before them stay. */
    count = PLACES_OF(d, size, places, 0);
    while (first < count && places[first].own != at)
        first++;
    for (int i = 2; i > 0 && first + i < count; i--)
        size = PUT(d, size, room, places[first + i], made.part[i], made.length[i]);
    for (int i = 0; i < KERNEL_PARTS; i++)
        kernel_free(made.part[i]);
done:
    RELEASE_ALL();
    return size;
}

size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t room, unsigned seed)
{
    struct place places[PLACES];
    uint32_t r = seed * 2654435761u;
    int count = PLACES_OF(data, size, places, 0);
    if (!(r >> 29) && count)
        size = CHANGE_SYMBOLS(data, size, room, r >> 4 & 0x1FFFF);
    else if (r >> 28 != 2 && count)
        size = CHANGE(data, size, room, places[(r >> 8) % (uint32_t)count]);
    else
        size = LLVMFuzzerMutate(data, size, room);
    if (r >> 4 & 15)
        PLACES_OF(data, size, places, 1);
    return size;
}

/* ---------------------------------------------------------------- without libFuzzer */

#ifdef REPLAY
size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t room)
{
    (void)room;
    if (size)
        data[size / 2] ^= 1;
    return size;
}

/* Runs each file, and what the mutator makes of it. */
int main(int argc, char **argv)
{
    static uint8_t file[1 << 20];
    LLVMFuzzerInitialize(&argc, &argv);
    for (int i = 1; i < argc; i++) {
        FILE *f = fopen(argv[i], "rb");
        size_t size;
        CHECK(f);
        size = fread(file, 1, sizeof file, f);
        fclose(f);
        LLVMFuzzerTestOneInput(file, size);
        LLVMFuzzerTestOneInput(file, LLVMFuzzerCustomMutator(file, size, sizeof file, (unsigned)i));
    }
    return 0;
}
#endif
