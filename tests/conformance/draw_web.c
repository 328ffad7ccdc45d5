/* Runs the rendering networks of the package for browsers as a program, so that sanitizers see what they do.
 *
 * stdin: the numbers of `input`, then values, positions, masks, features, scalings, offsets and the place. stdout: the
 * status or the count, and then the arrays of the Gaussians. Anchors are added in two pieces, from memory of their own.
 */
#include "../../refcodec/web/draw.c"

#include <stdio.h>

typedef struct {
    uint32_t features, width, offsets, values, anchors, kept, start, end, room;
    float distance_unit;
} input;

/* Returns so many numbers of stdin in a block of exactly their size, or ends the program. */
static void *numbers(size_t count, size_t size)
{
    size_t whole = count * size;
    void *block = malloc(whole ? whole : 1);
    if (!block || fread(block, size, count, stdin) != count) exit(70);
    return block;
}

static int say(int32_t status)
{
    return fwrite(&status, sizeof status, 1, stdout) == 1 ? 0 : 70;
}

/* Appends the anchors from `start` to before `end`, as copies. */
static int32_t add(const renderer *r, anchors *a, const input *in, void *const array[5], uint32_t start, uint32_t end)
{
    const size_t sizes[5] = {12, in->offsets, 4 * (size_t)in->features, 4 * SCALINGS, 12 * (size_t)in->offsets};
    void *piece[5];
    for (int i = 0; i < 5; i++) {
        size_t size = (end - start) * sizes[i];
        piece[i] = malloc(size ? size : 1);
        if (!piece[i]) exit(70);
        memcpy(piece[i], (uint8_t *)array[i] + start * sizes[i], size);
    }
    int32_t status = web_add_anchors(r, a, end - start, piece[0], piece[1], piece[2], piece[3], piece[4]);
    for (int i = 0; i < 5; i++) free(piece[i]);
    return status;
}

/* Adds the anchors and writes what the place sees. Returns the exit status. */
static int see(const renderer *r, anchors *a, const input *in, void *const array[5], const double *place)
{
    int32_t status = add(r, a, in, array, 0, in->anchors / 2);
    if (!status) status = add(r, a, in, array, in->anchors / 2, in->anchors);
    static const size_t sizes[7] = {12, 12, 16, 12, 4, 4, 1};
    void *out[7];
    for (int i = 0; i < 7; i++) out[i] = calloc(in->room ? in->room : 1, sizes[i]);
    if (!status)
        status = web_draw(r, a, in->start, in->end, place, 0, in->room, out[0], out[1], out[2], out[3], out[4], out[5],
                          out[6]);
    int ended = say(status);
    for (int i = 0; i < 7; i++) {
        if (status > 0 && fwrite(out[i], sizes[i], (size_t)status, stdout) != (size_t)status) ended = 70;
        free(out[i]);
    }
    return ended;
}

int main(void)
{
    input *in = numbers(1, sizeof *in);
    float *values = numbers(in->values, 4);
    uint32_t n = in->anchors;
    void *array[5] = {numbers(n, 12), numbers(n, in->offsets), numbers(n, 4 * (size_t)in->features),
                      numbers(n, 4 * SCALINGS), numbers(n, 12 * (size_t)in->offsets)};
    double *place = numbers(3, 8);
    renderer *r = web_make_renderer(in->features, in->width, in->offsets, in->distance_unit, values, in->values);
    free(values);
    anchors *a = r ? web_make_anchors(r, n, in->kept) : NULL;
    int ended = a ? see(r, a, in, array, place) : say(REFUSED);
    for (int i = 0; i < 5; i++) free(array[i]);
    free(place);
    free(a);
    free(r);
    free(in);
    return ended;
}
