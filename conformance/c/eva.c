/* The decoder in C with any file, for Frama-C's Eva: ALARMS.md has the command and what it says.
 *
 * Frama-C's fread gives any number of any bytes. The tables are any bytes too. Memory is not freed, because Eva has one
 * abstract block for many: ALARMS.md has the uses of FREE.
 */
#include <stdlib.h>

static void keep(void *block) { (void)block; }
#define free keep
#define main decoder_main
#include "decoder.c"
#undef main

#include <__fc_builtin.h>

int main(void)
{
    static struct scene s;
    MAKE_CRC_TABLE();
    LOAD_TABLES("decoder", &s.section);
    input = fopen("file", "rb");
    if (!input)
        return 1;
    if (Frama_C_interval(0, 1))
        output = fopen("output", "wb");
    if (Frama_C_interval(0, 1))
        probes = fopen("probes", "wb");
    DECODE_FILE(&s, 1);
    RELEASE();
    return 0;
}
