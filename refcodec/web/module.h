/* What the modules of the WebAssembly build share. */
#ifndef C3GS_MODULE_H
#define C3GS_MODULE_H
#include <stdint.h>
#include <stdlib.h>

#if defined(__wasm__)
#define EXPORT(name) __attribute__((export_name(name)))
#else
#define EXPORT(name)
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
