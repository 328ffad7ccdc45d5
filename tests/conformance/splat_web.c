/* Runs SPLAT of the kernel, which the package for browsers has, too, as a program, so that sanitizers see what it does.
 *
 * stdin: the numbers of `input`, then weights, biases, exponents, positions, masks, features, scalings and offsets.
 * stdout: the status or the count, and then the numbers of each Gaussian in a row. If `rows` is 0, the arrays without
 * gaps are computed, and joined here.
 */
#include "../../refcodec/native/splat.c"

#include <stdio.h>

typedef struct {
    uint32_t features, width, offsets, colours, weights, biases, anchors, room, rows;
} input;

/* Returns so many numbers of stdin in a block of exactly their size, or ends the program. */
static void *numbers(size_t count, size_t size)
{
    size_t whole_size = count * size;
    void *block = malloc(whole_size ? whole_size : 1);
    if (!block || fread(block, size, count, stdin) != count) exit(70);
    return block;
}

int main(void)
{
    input *in = numbers(1, sizeof *in);
    size_t n = in->anchors, k = in->offsets;
    void *layers[3] = {numbers(in->weights, 2), numbers(in->biases, 4), numbers(in->biases, 1)};
    void *array[5] = {numbers(n, 12), numbers(n, k), numbers(n, 4 * (size_t)in->features), numbers(n, 4 * SCALINGS),
                      numbers(n, 12 * k)};
    splatter *s = kernel_splatter_new(in->features, in->width, in->offsets, in->colours, layers[0], layers[1], layers[2]);
    const uint32_t widths[5] = {3, 3, 4, 1, in->colours}, all = 11 + in->colours;
    float *to[5], *row = malloc(4 * (size_t)all * in->room + 1);
    if (!row) exit(70);
    for (uint32_t i = 0, at = 0; i < 5; at += widths[i++]) {
        to[i] = in->rows ? row + at : malloc(4 * (size_t)widths[i] * in->room + 1);
        if (!to[i]) exit(70);
    }
    int32_t status = KERNEL_REFUSED;
    if (s)
        status = kernel_splat(s, in->anchors, array[0], array[1], array[2], array[3], array[4], in->room,
                           in->rows ? all : 0, to[0], to[1], to[2], to[3], to[4]);
    for (uint32_t i = 0, at = 0; !in->rows && i < 5; at += widths[i++]) {
        for (int32_t g = 0; g < status; g++)
            memcpy(row + (size_t)all * (size_t)g + at, to[i] + (size_t)widths[i] * (size_t)g, 4 * (size_t)widths[i]);
        free(to[i]);
    }
    size_t found = status > 0 ? (size_t)status : 0;
    int ended = fwrite(&status, sizeof status, 1, stdout) == 1 && fwrite(row, 4 * (size_t)all, found, stdout) == found;
    for (int i = 0; i < 5; i++) free(array[i]);
    for (int i = 0; i < 3; i++) free(layers[i]);
    free(row);
    free(s);
    free(in);
    return ended ? 0 : 70;
}
