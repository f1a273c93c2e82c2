/* Chooses between kernels that were compiled for three levels of x86-64 processors. See tools/kernel_hook.py. */

#include <cpuid.h>
#include <stdint.h>

typedef void run(const void *t, int64_t rows, int64_t state_stride, const double *state, double *other,
                 double *outputs, int64_t later, const double *later_inputs, double *values_1, double *room_1,
                 double *values_8, double *room_8);
run run_tape_v1, run_tape_v3, run_tape_v4;

enum { VECTORS_OF_256 = 0x06, VECTORS_OF_512 = 0xe6 }; /* registers that the operating system saves */

/* Return the level of this processor: 1, 3 (AVX2 and FMA) or 4 (AVX-512 too). */
int processor_level(void)
{
    unsigned a, b, c, d, saved, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE) || !(c & bit_FMA))
        return 1;
    __asm__("xgetbv" : "=a"(saved), "=d"(high) : "c"(0));
    if ((saved & VECTORS_OF_256) != VECTORS_OF_256 || !__get_cpuid_count(7, 0, &a, &b, &c, &d) || !(b & bit_AVX2))
        return 1;
    unsigned wanted = bit_AVX512F | bit_AVX512DQ | bit_AVX512CD | bit_AVX512BW | bit_AVX512VL;
    return (saved & VECTORS_OF_512) == VECTORS_OF_512 && (b & wanted) == wanted ? 4 : 3;
}

void run_tape(const void *t, int64_t rows, int64_t state_stride, const double *state, double *other, double *outputs,
              int64_t later, const double *later_inputs, double *values_1, double *room_1, double *values_8,
              double *room_8)
{
    static run *chosen;
    if (!chosen) {
        int level = processor_level();
        chosen = level == 4 ? run_tape_v4 : level == 3 ? run_tape_v3 : run_tape_v1;
    }
    chosen(t, rows, state_stride, state, other, outputs, later, later_inputs, values_1, room_1, values_8, room_8);
}
