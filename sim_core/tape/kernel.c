/* Runs a tape: a list of operations on arrays, recorded from numpy code. See program.py for the encoding.

Values lie in one array: value i of lane l is at [i * L + l]. A lane is one vessel. L is 1 or 8. The order of all
operations on a value is the same for both, and so is the result, bit for bit. */

#include <math.h>
#include <stdint.h>
#include <string.h>

/* A vector is a register of the processor: gcc keeps wider ones in memory, which takes three times as long. */
#if defined(__AVX512F__)
enum { BYTES = 64 };
#elif defined(__AVX__)
enum { BYTES = 32 };
#else
enum { BYTES = 16 };
#endif
typedef double vd __attribute__((vector_size(BYTES)));
typedef int64_t vi __attribute__((vector_size(BYTES)));
enum { NARROW = BYTES == 16 ? 2 : 4 };
typedef double vn __attribute__((vector_size(NARROW * 8)));
enum { LANES = 8, WIDTH = BYTES / 8 };

static inline __attribute__((always_inline)) vd loaded(const double *from)
{
    vd vector;
    memcpy(&vector, from, sizeof vector);
    return vector;
}

enum {
    NEGATIVE, ABSOLUTE, SQRT, SIN, COS, RINT, ISNAN, LOGICAL_NOT, FLOOR, SIGN, SQUARE,
    EXP, LOG, TAN, TANH, ARCCOS, ARCSIN, ARCTAN, CBRT, EXPM1,
    ADD, SUBTRACT, MULTIPLY, DIVIDE, MAXIMUM, MINIMUM, LESS, LESS_EQUAL, GREATER, GREATER_EQUAL, EQUAL, NOT_EQUAL,
    LOGICAL_AND, LOGICAL_OR, ARCTAN2, POWER, HYPOT,
    WHERE, MATMUL, DOT, INTERP, SIN_COS, SUM_OF_PRODUCTS, DIFFERENCE_OF_PRODUCTS, SPARSE
};

enum { RUN, SAME, TABLE }; /* where an operand lies: consecutive values, one value for all, a table of values */

#define REACH 1e6 /* of the reduction */

/* Sine and cosine of WIDTH angles, by reduction to (-pi/4, pi/4) in three parts of pi/2 and the polynomials of fdlibm.
   Returns which angles are within reach. */
static inline __attribute__((always_inline)) vi sine_cosine(const double *restrict x, vd *sine, vd *cosine)
{
    const double magic = 6755399441055744.0; /* 1.5 * 2^52 rounds to an integer and leaves its bits */
    vd v, magic_v = (vd){0} + magic;
    memcpy(&v, x, sizeof v);
    vd shifted = v * 0.63661977236758134308 + magic_v;
    vd n = shifted - magic_v;
    vi quadrant = (vi)shifted;
    vd r = v - n * 1.57079632673412561417e+00;
    vd w = n * 6.07710050630396597660e-11;
    vd y = r - w;
    vd low = (r - y) - w - n * 2.02226624879595063154e-21;
    vd z = y * y;
    vd p = z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06
           + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))));
    vd s = y + (low * (1.0 - 0.5 * z) + y * z * (-1.66666666666666324348e-01 + p));
    vd q = z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05
           + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
    vd half = 0.5 * z, head = 1.0 - half;
    vd c = head + (((1.0 - head) - half) + (q - y * low));
    vi odd = -(quadrant & 1), of_sine = (quadrant & 2) << 62, of_cosine = ((quadrant + 1) & 2) << 62;
    *sine = (vd)((((vi)c & odd) | ((vi)s & ~odd)) ^ of_sine);
    *cosine = (vd)((((vi)s & odd) | ((vi)c & ~odd)) ^ of_cosine);
    return (v < REACH) & (v > -REACH);
}

/* Both of each angle, or one where the other is NULL. */
static inline __attribute__((always_inline)) void
trigonometric(const double *restrict a, double *restrict sine, double *restrict cosine, int64_t count)
{
    vi within = (vi){0} - 1;
    for (int64_t i = 0; i < count; i += WIDTH) {
        double in[WIDTH] = {0};
        size_t size = (size_t)(count - i < WIDTH ? count - i : WIDTH) * sizeof *in;
        vd s, c;
        if (size == sizeof in)
            within &= sine_cosine(a + i, &s, &c);
        else
            memcpy(in, a + i, size), within &= sine_cosine(in, &s, &c);
        if (sine)
            memcpy(sine + i, &s, size);
        if (cosine)
            memcpy(cosine + i, &c, size);
    }
    int64_t all = -1;
    for (int lane = 0; lane < WIDTH; lane++)
        all &= within[lane];
    for (int64_t i = 0; !all && i < count; i++)
        if (!(fabs(a[i]) < REACH)) {
            if (sine)
                sine[i] = sin(a[i]);
            if (cosine)
                cosine[i] = cos(a[i]);
        }
}

/* Arc cosines, as fdlibm: by a rational function about 0, and by the half angle near 1 and -1. */
static void arc_cosines(int64_t count, double *restrict out, const double *restrict a)
{
    const double pio2_hi = 1.57079632679489655800e+00, pio2_lo = 6.12323399573676603587e-17;
    for (int64_t i = 0; i < count; i++) {
        double x = a[i], size = fabs(x);
        int near = size >= 0.5;
        double z = near ? 0.5 * (1.0 - size) : x * x;
        double p = z * (1.66666666666666657415e-01 + z * (-3.25565818622400915405e-01 + z * (2.01212532134862925881e-01
                   + z * (-4.00555345006794114027e-02 + z * (7.91534994289814532176e-04
                   + z * 3.47933107596021167570e-05)))));
        double q = 1.0 + z * (-2.40339491173441421878e+00 + z * (2.02094576023350569471e+00
                   + z * (-6.88283971605453293030e-01 + z * 7.70381505559019352791e-02)));
        double r = p / q, s = sqrt(z);
        double middle = pio2_hi - (x - (pio2_lo - x * r));
        double below = 2.0 * (pio2_hi - (s + (r * s - pio2_lo)));
        double above = 2.0 * (s + r * s);
        out[i] = near ? (x < 0.0 ? below : above) : middle;
    }
}

#define EACH(expression) for (int64_t i = 0; i < count; i++) out[i] = (expression); return

/* Loops over whole vectors, as gcc chooses narrower ones. */
#define EACH_VECTOR(expression, of_vectors)             \
    int64_t i = 0;                                      \
    for (; i + WIDTH <= count; i += WIDTH) {            \
        vd vector = (of_vectors);                       \
        memcpy(out + i, &vector, sizeof vector);        \
    }                                                   \
    for (; i < count; i++)                              \
        out[i] = (expression);                          \
    return
#define A loaded(a + i)
#define B loaded(b + i)
#define C loaded(c + i)
#define D loaded(d + i)

static void element_wise(int op, int64_t count, double *restrict out, const double *restrict a,
                         const double *restrict b, const double *restrict c, const double *restrict d)
{
    switch (op) {
    case NEGATIVE: EACH(-a[i]);
    case ABSOLUTE: EACH(fabs(a[i]));
    case SQRT: EACH(sqrt(a[i]));
    case SIN: trigonometric(a, out, NULL, count); return;
    case COS: trigonometric(a, NULL, out, count); return;
    case RINT: EACH(rint(a[i]));
    case ISNAN: EACH(a[i] != a[i]);
    case LOGICAL_NOT: EACH(a[i] == 0.0);
    case FLOOR: EACH(floor(a[i]));
    case SIGN: EACH((a[i] > 0.0) - (a[i] < 0.0) + (a[i] != a[i] ? a[i] : 0.0));
    case SQUARE: EACH(a[i] * a[i]);
    case EXP: EACH(exp(a[i]));
    case LOG: EACH(log(a[i]));
    case TAN: EACH(tan(a[i]));
    case TANH: EACH(tanh(a[i]));
    case ARCCOS: arc_cosines(count, out, a); return;
    case ARCSIN: EACH(asin(a[i]));
    case ARCTAN: EACH(atan(a[i]));
    case CBRT: EACH(cbrt(a[i]));
    case EXPM1: EACH(expm1(a[i]));
    case ADD: { EACH_VECTOR(a[i] + b[i], A + B); }
    case SUBTRACT: { EACH_VECTOR(a[i] - b[i], A - B); }
    case MULTIPLY: { EACH_VECTOR(a[i] * b[i], A * B); }
    case DIVIDE: { EACH_VECTOR(a[i] / b[i], A / B); }
    case MAXIMUM: EACH(a[i] >= b[i] || a[i] != a[i] ? a[i] : b[i]);
    case MINIMUM: EACH(a[i] <= b[i] || a[i] != a[i] ? a[i] : b[i]);
    case LESS: EACH(a[i] < b[i]);
    case LESS_EQUAL: EACH(a[i] <= b[i]);
    case GREATER: EACH(a[i] > b[i]);
    case GREATER_EQUAL: EACH(a[i] >= b[i]);
    case EQUAL: EACH(a[i] == b[i]);
    case NOT_EQUAL: EACH(a[i] != b[i]);
    case LOGICAL_AND: EACH(a[i] != 0.0 && b[i] != 0.0);
    case LOGICAL_OR: EACH(a[i] != 0.0 || b[i] != 0.0);
    case ARCTAN2: EACH(atan2(a[i], b[i]));
    case POWER: EACH(pow(a[i], b[i]));
    case HYPOT: EACH(hypot(a[i], b[i]));
    case WHERE: EACH(a[i] != 0.0 ? b[i] : c[i]);
    case SUM_OF_PRODUCTS: { EACH_VECTOR(a[i] * b[i] + c[i] * d[i], A * B + C * D); }
    case DIFFERENCE_OF_PRODUCTS: { EACH_VECTOR(a[i] * b[i] - c[i] * d[i], A * B - C * D); }
    }
}

#undef A
#undef B
#undef C
#undef D

/* Up to eight columns of one row of the product, of one lane. Vectors hold the sums: gcc leaves an array in memory. */
static inline __attribute__((always_inline)) void
matmul_of_columns(const int used, int64_t inner, int64_t columns, double *restrict out, const double *restrict a,
                  const double *restrict matrix)
{
    const int whole = used / NARROW, rest = used % NARROW;
    vn sum[8 / NARROW + 1] = {{0}};
    for (int64_t k = 0; k < inner; k++, matrix += columns) {
        for (int part = 0; part < whole; part++) {
            vn factors;
            memcpy(&factors, matrix + part * NARROW, sizeof factors);
            sum[part] += a[k] * factors;
        }
        vn last = {0};
        for (int t = 0; t < rest; t++)
            last[t] = matrix[whole * NARROW + t];
        if (rest)
            sum[whole] += a[k] * last;
    }
    for (int part = 0; part < whole; part++)
        memcpy(out + part * NARROW, &sum[part], sizeof(vn));
    for (int t = 0; t < rest; t++)
        out[whole * NARROW + t] = sum[whole][t];
}

/* (rows, inner) @ (inner, columns) constant, of one lane. */
static void matmul_of_one(int64_t rows, int64_t inner, int64_t columns, double *restrict out,
                          const double *restrict a, const double *restrict matrix)
{
    for (int64_t i = 0; i < rows; i++, a += inner, out += columns) {
        int64_t j = 0;
        for (; j + 8 <= columns; j += 8)
            matmul_of_columns(8, inner, columns, out + j, a, matrix + j);
        if (j + 4 <= columns) {
            matmul_of_columns(4, inner, columns, out + j, a, matrix + j);
            j += 4;
        }
        switch (columns - j) { /* loops of known length are faster */
        case 1: matmul_of_columns(1, inner, columns, out + j, a, matrix + j); break;
        case 2: matmul_of_columns(2, inner, columns, out + j, a, matrix + j); break;
        case 3: matmul_of_columns(3, inner, columns, out + j, a, matrix + j);
        }
    }
}

/* Some columns of the product of one row, of eight lanes. */
static inline __attribute__((always_inline)) void
matmul_of_row(const int columns, int64_t inner, int64_t stride, double *restrict out, const double *restrict a,
              const double *restrict matrix)
{
    vd sum[LANES / WIDTH][4] = {{{0}}};
    for (int64_t k = 0; k < inner; k++)
        for (int part = 0; part < LANES / WIDTH; part++) {
            vd x = loaded(a + k * LANES + part * WIDTH);
            for (int t = 0; t < columns; t++)
                sum[part][t] += x * matrix[k * stride + t];
        }
    for (int part = 0; part < LANES / WIDTH; part++)
        for (int t = 0; t < columns; t++)
            memcpy(out + t * LANES + part * WIDTH, &sum[part][t], sizeof(vd));
}

/* The same of eight lanes. */
static void matmul_of_eight(int64_t rows, int64_t inner, int64_t columns, double *restrict out,
                            const double *restrict a, const double *restrict matrix)
{
    for (int64_t i = 0; i < rows; i++, a += inner * LANES, out += columns * LANES) {
        int64_t j = 0;
        for (; j + 4 <= columns; j += 4)
            matmul_of_row(4, inner, columns, out + j * LANES, a, matrix + j);
        switch (columns - j) { /* loops of known length are faster */
        case 1: matmul_of_row(1, inner, columns, out + j * LANES, a, matrix + j); break;
        case 2: matmul_of_row(2, inner, columns, out + j * LANES, a, matrix + j); break;
        case 3: matmul_of_row(3, inner, columns, out + j * LANES, a, matrix + j);
        }
    }
}

static inline __attribute__((always_inline)) void
matmul(const int L, int64_t rows, int64_t inner, int64_t columns, double *restrict out, const double *restrict a,
       const double *restrict matrix)
{
    if (L > 1) {
        matmul_of_eight(rows, inner, columns, out, a, matrix);
        return;
    }
    matmul_of_one(rows, inner, columns, out, a, matrix);
}

/* A product with a matrix of mostly zeros. `terms`: for each value of the result, the count of its terms and their
   places. The factors lie in the order of the terms. */
static inline __attribute__((always_inline)) void
sparse(const int L, int64_t count, double *restrict out, const double *values, const int32_t *terms,
       const double *factors)
{
    for (int64_t i = 0; i < count; i++, out += L) {
        int32_t left = *terms++;
        if (L == 1) {
            double sum = 0.0;
            for (; left > 0; left--)
                sum += values[*terms++] * *factors++;
            *out = sum;
            continue;
        }
        vd sums[LANES / WIDTH] = {{0}};
        for (; left > 0; left--, terms++, factors++)
            for (int part = 0; part < LANES / WIDTH; part++)
                sums[part] += loaded(values + (int64_t)*terms * LANES + part * WIDTH) * *factors;
        memcpy(out, sums, sizeof sums);
    }
}

static void interpolate(int64_t count, double *restrict out, const double *restrict a, int64_t points,
                        const double *restrict xp, const double *restrict fp)
{
    for (int64_t i = 0; i < count; i++) {
        double x = a[i];
        if (x != x || x <= xp[0] || x >= xp[points - 1]) {
            out[i] = x != x ? x : x <= xp[0] ? fp[0] : fp[points - 1];
            continue;
        }
        int64_t low = 0, high = points - 1;
        while (high - low > 1) {
            int64_t middle = (low + high) / 2;
            if (xp[middle] <= x)
                low = middle;
            else
                high = middle;
        }
        out[i] = (fp[low + 1] - fp[low]) / (xp[low + 1] - xp[low]) * (x - xp[low]) + fp[low];
    }
}

/* The values of an operand, consecutive: in place, or brought into `room`. */
static inline __attribute__((always_inline)) const double *
operand(const int L, const int32_t *code, int64_t count, const double *values, const int32_t *tables, double *room)
{
    int32_t where = code[0], first = code[1];
    if (where == RUN)
        return values + (int64_t)first * L;
    for (int64_t i = 0; i < count; i++) {
        int64_t from = where == SAME ? first : tables[first + i];
        for (int l = 0; l < L; l++)
            room[i * L + l] = values[from * L + l];
    }
    return room;
}

static inline __attribute__((always_inline)) void
run_lanes(const int L, const int32_t *code, int64_t operations, const int32_t *tables, const double *matrices,
          double *restrict values, double *restrict room, int64_t room_size)
{
    double *second = room + room_size * L, *third = second + room_size * L, *fourth = third + room_size * L;
    for (int64_t number = 0; number < operations; number++) {
        int op = code[0];
        int64_t count = code[1];
        double *out = values + (int64_t)code[2] * L;
        const int32_t *operands = code + 4;
        const int32_t *extra = operands + 2 * code[3];
        switch (op) {
        case MATMUL: { /* extra: inner, columns, place of the matrix */
            int64_t inner = extra[0], columns = extra[1], rows = count / columns;
            matmul(L, rows, inner, columns, out, operand(L, operands, rows * inner, values, tables, room),
                   matrices + extra[2]);
            code = extra + 3;
            break;
        }
        case SPARSE: /* extra: places of the terms and of the factors */
            sparse(L, count, out, values, tables + extra[0], matrices + extra[1]);
            code = extra + 2;
            break;
        case DOT: { /* extra: terms; operands hold (terms, count) values */
            int64_t terms = extra[0];
            const double *a = operand(L, operands, terms * count, values, tables, room);
            const double *b = operand(L, operands + 2, terms * count, values, tables, second);
            for (int64_t i = 0; i < count * L; i++)
                out[i] = a[i] * b[i];
            for (int64_t k = 1; k < terms; k++)
                for (int64_t i = 0; i < count * L; i++)
                    out[i] += a[k * count * L + i] * b[k * count * L + i];
            code = extra + 1;
            break;
        }
        case INTERP: /* extra: points, places of the tables */
            interpolate(count * L, out, operand(L, operands, count, values, tables, room), extra[0],
                        matrices + extra[1], matrices + extra[2]);
            code = extra + 3;
            break;
        case SIN_COS: /* the cosines follow the sines */
            trigonometric(operand(L, operands, count, values, tables, room), out, out + count * L, count * L);
            code = extra;
            break;
        default: {
            const double *a = operand(L, operands, count, values, tables, room);
            const double *b = code[3] > 1 ? operand(L, operands + 2, count, values, tables, second) : a;
            const double *c = code[3] > 2 ? operand(L, operands + 4, count, values, tables, third) : a;
            const double *d = code[3] > 3 ? operand(L, operands + 6, count, values, tables, fourth) : a;
            element_wise(op, count * L, out, a, b, c, d);
            code = extra;
        }
        }
    }
}

static void run_1(const int32_t *code, int64_t operations, const int32_t *tables, const double *matrices,
                  double *values, double *room, int64_t room_size)
{
    run_lanes(1, code, operations, tables, matrices, values, room, room_size);
}

static void run_8(const int32_t *code, int64_t operations, const int32_t *tables, const double *matrices,
                  double *values, double *room, int64_t room_size)
{
    run_lanes(8, code, operations, tables, matrices, values, room, room_size);
}

typedef struct {
    const int32_t *code;
    const int32_t *tables;
    const double *matrices;
    const int32_t *outputs; /* the values to return, of each row */
    int64_t operations;
    int64_t constants; /* the inputs follow the constants */
    int64_t state_inputs; /* of each row of `state` */
    int64_t other_inputs; /* of each row of `other` */
    int64_t step_inputs; /* the first of the other inputs, which differ in each step */
    int64_t output_count;
    int64_t room_size;
} tape;

/* Run the tape once for all rows. state_stride: columns of a row of `state`, which may be `outputs`. */
static void run_step(const tape *t, int64_t rows, int64_t state_stride, const double *state, const double *other,
                     double *outputs, double *values_1, double *room_1, double *values_8, double *room_8)
{
    int64_t row = 0;
    while (row < rows) {
        int64_t left = rows - row;
        int lanes = left > 2 ? 8 : 1;
        int64_t used = lanes == 1 ? 1 : left < 8 ? left : 8;
        double *values = lanes == 1 ? values_1 : values_8;
        double *in = values + t->constants * lanes;
        for (int l = 0; l < lanes; l++) {
            int64_t from = row + (l < used ? l : used - 1);
            const double *s = state + from * state_stride, *o = other + from * t->other_inputs;
            for (int64_t i = 0; i < t->state_inputs; i++)
                in[i * lanes + l] = s[i];
            for (int64_t i = 0; i < t->other_inputs; i++)
                in[(t->state_inputs + i) * lanes + l] = o[i];
        }
        if (lanes == 1)
            run_1(t->code, t->operations, t->tables, t->matrices, values, room_1, t->room_size);
        else
            run_8(t->code, t->operations, t->tables, t->matrices, values, room_8, t->room_size);
        for (int64_t l = 0; l < used; l++)
            for (int64_t i = 0; i < t->output_count; i++)
                outputs[(row + l) * t->output_count + i] = values[(int64_t)t->outputs[i] * lanes + l];
        row += used;
    }
}

#ifndef RUN_TAPE
#define RUN_TAPE run_tape
#endif

/* Run the tape for 1 + `later` steps. The outputs begin with the state of the next step. later_inputs: for each later
   step, the inputs that differ. Values and room are the working memory of one lane and of eight, with the constants in
   place. */
void RUN_TAPE(const tape *t, int64_t rows, int64_t state_stride, const double *state, double *other, double *outputs,
              int64_t later, const double *later_inputs, double *values_1, double *room_1, double *values_8,
              double *room_8)
{
    run_step(t, rows, state_stride, state, other, outputs, values_1, room_1, values_8, room_8);
    for (; later > 0; later--, later_inputs += t->step_inputs) {
        for (int64_t row = 0; row < rows; row++)
            for (int64_t i = 0; i < t->step_inputs; i++)
                other[row * t->other_inputs + i] = later_inputs[i];
        run_step(t, rows, t->output_count, outputs, other, outputs, values_1, room_1, values_8, room_8);
    }
}
