/* What the files beside kernel.c share: how a function is exported, and memory in one block. */
#ifndef C3GS_MODULE_H
#define C3GS_MODULE_H
#include <stdint.h>
#include <stdlib.h>

#include "kernel.h"

/* name: in WebAssembly. A library has the name of the function. */
#if defined(__wasm__)
#define EXPORT(name) __attribute__((export_name(name)))
#else
#define EXPORT(name) KERNEL_API
#endif

/* Gives pieces of a block, or counts them while there is none. */
typedef struct {
    uint8_t *block;
    uint64_t used;
} pieces;

static inline void *piece(pieces *p, uint64_t count, uint64_t size)
{
    uint64_t at = p->used;
    p->used += (count * size + 15) / 16 * 16;
    return p->block ? p->block + at : NULL;
}

#endif
