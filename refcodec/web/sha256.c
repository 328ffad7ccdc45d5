/* SHA-256 (FIPS 180-4) of bytes that come piece by piece. Browsers hash whole buffers only. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "../native/module.h"

enum { BLOCK = 64, ROUNDS = 64, LENGTH_AT = 56, DIGEST = 32 };

typedef struct {
    uint32_t state[8];
    uint64_t length;
    uint8_t rest[BLOCK];
} sha256;

static const uint32_t first[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                  0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
static const uint32_t constant[ROUNDS] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2,
};

static uint32_t turn(uint32_t x, int by) { return x >> by | x << (32 - by); }

static void add_block(uint32_t state[8], const uint8_t *block)
{
    uint32_t w[ROUNDS], v[8];
    for (int i = 0; i < 16; i++) {
        memcpy(&w[i], block + 4 * i, 4);
        w[i] = __builtin_bswap32(w[i]);
    }
    for (int i = 16; i < ROUNDS; i++) {
        uint32_t a = w[i - 15], b = w[i - 2];
        w[i] = w[i - 16] + (turn(a, 7) ^ turn(a, 18) ^ a >> 3) + w[i - 7] + (turn(b, 17) ^ turn(b, 19) ^ b >> 10);
    }
    memcpy(v, state, sizeof v);
    for (int i = 0; i < ROUNDS; i++) {
        uint32_t a = v[0], e = v[4];
        uint32_t one = v[7] + (turn(e, 6) ^ turn(e, 11) ^ turn(e, 25)) + ((e & v[5]) ^ (~e & v[6]));
        uint32_t two = (turn(a, 2) ^ turn(a, 13) ^ turn(a, 22)) + ((a & v[1]) ^ (a & v[2]) ^ (v[1] & v[2]));
        memmove(v + 1, v, 7 * sizeof *v);
        one += constant[i] + w[i];
        v[4] += one;
        v[0] = one + two;
    }
    for (int i = 0; i < 8; i++) state[i] += v[i];
}

/* Returns a new hash, or NULL without memory. It is freed with `release`. */
EXPORT("makeHash") sha256 *hash_new(void)
{
    sha256 *h = calloc(1, sizeof *h);
    if (h) memcpy(h->state, first, sizeof first);
    return h;
}

EXPORT("addToHash") void hash_add(sha256 *h, const uint8_t *bytes, uint32_t count)
{
    uint32_t held = (uint32_t)(h->length % BLOCK);
    h->length += count;
    while (count) {
        uint32_t part = BLOCK - held < count ? BLOCK - held : count;
        if (part == BLOCK) {
            add_block(h->state, bytes);
        } else {
            memcpy(h->rest + held, bytes, part);
            held += part;
            if (held == BLOCK) {
                add_block(h->state, h->rest);
                held = 0;
            }
        }
        bytes += part;
        count -= part;
    }
}

/* Writes the digest, DIGEST bytes. The hash takes no bytes after that. */
EXPORT("endHash") void hash_end(sha256 *h, uint8_t *digest)
{
    uint32_t held = (uint32_t)(h->length % BLOCK);
    uint64_t bits = __builtin_bswap64(8 * h->length);
    h->rest[held++] = 0x80;
    memset(h->rest + held, 0, BLOCK - held);
    if (held > LENGTH_AT) {
        add_block(h->state, h->rest);
        memset(h->rest, 0, BLOCK);
    }
    memcpy(h->rest + LENGTH_AT, &bits, 8);
    add_block(h->state, h->rest);
    for (int i = 0; i < 8; i++) {
        uint32_t word = __builtin_bswap32(h->state[i]);
        memcpy(digest + 4 * i, &word, 4);
    }
}
