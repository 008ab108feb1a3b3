/* zswarm's epuck on aggregation, foraging and grid exploration, with reference model 1.2 and a feed-forward network without
   hidden nodes: the same algorithm as zswarm/sims/epuck/. With -O2 -ffp-contract=off it has the same bits. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#define LANES 8
#define MOST 104 /* robots and spare lanes */
#define MOST_WALLS 16
#define MOST_PAIRS (MOST * (MOST + MOST_WALLS))
#define SENSORS 8
#define NOISY 19
#define INPUTS 14
#define HEADER 4
#define MEMORY 11
#define VOTES 5
#define QUANTILES 129
#define CELLS 10

#define RADIUS ((double)0.035f)
#define MASS ((double)0.4f)
#define WHEEL_DISTANCE ((double)0.053f)
#define RING (RADIUS + 0.001)
#define RAY ((double)0.05f)
#define SUBSTEP_S 0.01
#define PER_MASS (1.0 / MASS)
#define INERTIA (0.5 * MASS * (2.0 * RADIUS) * (2.0 * RADIUS))
#define PER_INERTIA (1.0 / INERTIA)
#define MOST_IMPULSE (1.5 * SUBSTEP_S)
#define MOST_CHANGE (MOST_IMPULSE * PER_MASS)
#define MOST_TURN (MOST_IMPULSE * PER_INERTIA)
#define SETTLED 1e-15
#define BETWEEN_ROBOTS (0.7 * 0.7)
#define WITH_WALL (0.7 * 0.1)
#define PI 3.14159265358979311600e00

typedef double lanes __attribute__((vector_size(64), aligned(8), may_alias));
typedef int64_t which __attribute__((vector_size(64), aligned(8), may_alias));
typedef float singles __attribute__((vector_size(32), aligned(4), may_alias));

enum { X, Y, ANGLE, COSINE, SINE, SPEED_X, SPEED_Y, SPIN, TARGET_X, TARGET_Y, TARGET_SPIN, PUSH_X, PUSH_Y, PUSH_SPIN,
       LEFT, RIGHT, PROXIMITY, LIGHT = PROXIMITY + SENSORS, GROUND = LIGHT + SENSORS, HEARD = GROUND + 3, HEARD_X, HEARD_Y,
       CARRIES, TOUCHES, BRIGHTNESS, BEARING, ROWS };
enum { CENTRE_X, CENTRE_Y, WALL_COSINE, WALL_SINE, HALF_LENGTH, HALF_WIDTH, WALL_HEIGHT, WALL_COLUMNS };
enum { SHAPE, PLACE_X, PLACE_Y, SIZE_X, SIZE_Y, GREY, PLACE_COLUMNS };
enum { WHEEL_NOISE, PROXIMITY_NOISE, LIGHT_NOISE, GROUND_NOISE, LOSS, LAMP_X, LAMP_Y, LAMP_Z, INTENSITY };
enum { RAY_X, RAY_Y, ANGLES, ANGLES_X, ANGLES_Y, DIRECTIONS_X, DIRECTIONS_Y, TABLES };
enum { AGGREGATION, FORAGING, GRID_EXPLORATION };
enum { BODY_X, BODY_Y, BODY_SPIN, MOTOR_X, MOTOR_Y, MOTOR_SPIN, WANTED_X, WANTED_Y, WANTED_SPIN, BODY_COLUMNS = 16 };

typedef struct { double normal_x, normal_y, arm_x, arm_y, friction, along_mass, across_mass, along, across; } contact;
typedef struct { int first, second, group, level; } link;
typedef struct { double along, across; int64_t touched; } impulse;

/* The problem. */
static int number, width, walls, places, mission;
static double hearing, around, free_radius;
static const double *constants, *wall, *place, *greys;
static lanes table[TABLES];

/* The state of a trial. */
static lanes rows[ROWS][MOST / LANES], noise[NOISY][MOST / LANES], seen[INPUTS][MOST / LANES];
static lanes memory[2 * (MEMORY + VOTES)][MOST / LANES], rays[MOST], indices[MOST / LANES];
static double chances[2][MOST * MOST], cells[CELLS * CELLS], bodies[MOST][BODY_COLUMNS], before[MOST], now[MOST];
static float observations[MOST][INPUTS + 2], actions[2][MOST];
static int near[MOST * MOST + LANES], beside[MOST * MOST + LANES], audible[MOST * MOST + LANES], sender[MOST * MOST + LANES];
static int received[MOST * MOST + LANES], pairs[MOST_PAIRS][2];
static int touching[MOST], active[MOST], leaders[MOST], levels[MOST], groups[MOST], order[MOST_PAIRS], level_starts[MOST_PAIRS];
static contact contacts[MOST_PAIRS + 1];
static link links[MOST_PAIRS];
static impulse impulses[MOST_PAIRS];
static uint8_t set_bits[256][LANES]; /* of a byte, the lowest first */
static double total, hearings;
static int64_t step, substep;
static uint64_t stream;

#define OF(row) ((double *)rows[row])

/* ---- lanes ---- */

static inline lanes pick(which yes, lanes a, lanes b) { return (lanes)((yes & (which)a) | (~yes & (which)b)); }

static inline lanes fill(double one) { return one - (lanes){0}; }

static inline lanes roots(lanes a) {
    lanes made;
    for (int lane = 0; lane < LANES; lane++) made[lane] = sqrt(a[lane]);
    return made;
}

static inline lanes floors(lanes a) {
    lanes made;
    for (int lane = 0; lane < LANES; lane++) made[lane] = floor(a[lane]);
    return made;
}

#ifdef __AVX512DQ__
#include <immintrin.h>
static inline uint32_t to_bits(which yes) { return _mm512_movepi64_mask((__m512i)yes); }
#elif defined __AVX__
#include <immintrin.h>
static inline uint32_t to_bits(which yes) {
    union { which all; __m256d half[2]; } parts = {yes};
    return _mm256_movemask_pd(parts.half[0]) | _mm256_movemask_pd(parts.half[1]) << 4;
}
#else
static inline uint32_t to_bits(which yes) {
    uint32_t bits = 0;
    for (int lane = 0; lane < LANES; lane++) bits |= (uint32_t)(yes[lane] & 1) << lane;
    return bits;
}
#endif

static inline int list_true(which yes, int first, int *array) {
    uint32_t bits = to_bits(yes);
    for (int lane = 0; lane < LANES; lane++) array[lane] = first + set_bits[bits][lane];
    return __builtin_popcount(bits);
}

/* ---- numbers ---- */

static inline double at_most(double a, double b) { return a < b ? a : b; }

static inline double at_least(double a, double b) { return a > b ? a : b; }

static inline uint64_t scrambled(uint64_t word) {
    word = (word ^ (word >> 30)) * 0xBF58476D1CE4E5B9u;
    word = (word ^ (word >> 27)) * 0x94D049BB133111EBu;
    return word ^ (word >> 31);
}

static inline uint64_t draw_word(void) { return scrambled(stream += 0x9E3779B97F4A7C15u); }

static inline double draw_uniform(void) { return (double)(draw_word() >> 11) * 0x1p-53; }

/* Row r and column c is number stride c + r. */
static inline void draw_uniforms(double *numbers, int row_length, int stride, int columns) {
    for (int row = 0; row < stride; row++)
        for (int column = 0; column < columns; column++) {
            uint64_t ahead = (uint64_t)(stride * column + row + 1) * 0x9E3779B97F4A7C15u;
            numbers[row * row_length + column] = (double)(scrambled(stream + ahead) >> 11) * 0x1p-53;
        }
}

static inline void skip(uint64_t words) { stream += words * 0x9E3779B97F4A7C15u; }

static double logarithm(double x) {
    union { double number; uint64_t bits; } u = {x};
    int64_t exponent = (int64_t)(u.bits >> 52) - 1022;
    u.bits = (u.bits & ((1ull << 52) - 1)) | 1022ull << 52;
    if (u.number < 7.07106781186547524401e-01) {
        u.number *= 2.0;
        exponent--;
    }
    double f = u.number - 1.0, k = (double)exponent, s = f / (2.0 + f), z = s * s, w = z * z;
    double r = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01)) +
               z * (6.666666666666735130e-01 +
                    w * (2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)));
    double half = 0.5 * f * f;
    return k * 6.93147180369123816490e-01 - ((half - (s * (half + r) + k * 1.90821492927058770002e-10)) - f);
}

static double exponential(double x) {
    if (x > 709.782712893383973096) return INFINITY;
    if (x < -745.13321910194110842) return 0.0;
    int64_t k = (int64_t)(x * 1.44269504088896338700e00 + (x >= 0.0 ? 0.5 : -0.5));
    double high = x - k * 6.93147180369123816490e-01, low = k * 1.90821492927058770002e-10, r = high - low, t = r * r;
    double c = r - t * (1.66666666666666019037e-01 +
                        t * (-2.77777777770155933842e-03 +
                             t * (6.61375632143793436117e-05 + t * (-1.65339022054652515390e-06 + t * 4.13813679705723846039e-08))));
    double y = 1.0 - ((low - (r * c) / (2.0 - c)) - high);
    union { uint64_t bits; double number; } power = {(uint64_t)(k + 1023) << 52};
    if (k >= -1022 && k < 1024) return y * power.number;
    return ldexp(y, (int)k);
}

static double quotient(const double (*p)[8], double x) {
    double above = ((p[0][7] * x + p[0][6]) * x + p[0][5]) * x + p[0][4];
    double below = ((p[1][7] * x + p[1][6]) * x + p[1][5]) * x + p[1][4];
    above = (((above * x + p[0][3]) * x + p[0][2]) * x + p[0][1]) * x + p[0][0];
    below = (((below * x + p[1][3]) * x + p[1][2]) * x + p[1][1]) * x + p[1][0];
    return above / below;
}

static const double CENTRE[2][8] = {
    {3.3871328727963666080e0, 1.3314166789178437745e2, 1.9715909503065514427e3, 1.3731693765509461125e4, 4.5921953931549871457e4,
     6.7265770927008700853e4, 3.3430575583588128105e4, 2.5090809287301226727e3},
    {1.0, 4.2313330701600911252e1, 6.8718700749205790830e2, 5.3941960214247511077e3, 2.1213794301586595867e4,
     3.9307895800092710610e4, 2.8729085735721942674e4, 5.2264952788528545610e3}};
static const double TAIL[2][8] = {
    {1.42343711074968357734e0, 4.63033784615654529590e0, 5.76949722146069140550e0, 3.64784832476320460504e0,
     1.27045825245236838258e0, 2.41780725177450611770e-1, 2.27238449892691845833e-2, 7.74545014278341407640e-4},
    {1.0, 2.05319162663775882187e0, 1.67638483018380384940e0, 6.89767334985100004550e-1, 1.48103976427480074590e-1,
     1.51986665636164571966e-2, 5.47593808499534494600e-4, 1.05075007164441684324e-9}};
static const double FAR_TAIL[2][8] = {
    {6.65790464350110377720e0, 5.46378491116411436990e0, 1.78482653991729133580e0, 2.96560571828504891230e-1,
     2.65321895265761230930e-2, 1.24266094738807843860e-3, 2.71155556874348757815e-5, 2.01033439929228813265e-7},
    {1.0, 5.99832206555887937690e-1, 1.36929880922735805310e-1, 1.48753612908506148525e-2, 7.86869131145613259100e-4,
     1.84631831751005468180e-5, 1.42151175831644588870e-7, 2.04426310338993978564e-15}};

static double draw_normal(void) {
    double p = ((double)(draw_word() >> 12) + 0.5) * 0x1p-52, q = p - 0.5;
    if (fabs(q) <= 0.425) return q * quotient(CENTRE, 0.180625 - q * q);
    double r = sqrt(-logarithm(0.5 - fabs(q)));
    double tail = r <= 5.0 ? quotient(TAIL, r - 1.6) : quotient(FAR_TAIL, r - 5.0);
    return q < 0.0 ? -tail : tail;
}

/* Cosines and sines of eight angles, of at most a million. */
static inline void turned(lanes x, lanes *cosines, lanes *sines) {
    which negative = x < 0.0;
    lanes size = pick(negative, 0.0 - x, x), k = floors(size * 6.36619772367581382433e-01 + 0.5);
    lanes most = size - k * 1.57079632673412561417e00, second = k * 6.07710050630396597660e-11, rest = most - second;
    lanes lost = k * 2.02226624879595063154e-21 - ((most - rest) - second), r = rest - lost, tail = (rest - r) - lost;
    lanes quarter = k - 4.0 * floors(k * 0.25), z = r * r, v = z * r;
    lanes p = 8.33333333332248946124e-03 +
              z * (-1.98412698298579493134e-04 +
                   z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)));
    lanes sine = r - ((z * (0.5 * tail - v * p) - tail) - v * -1.66666666666666324348e-01);
    p = z * (4.16666666666666019037e-02 +
             z * (-1.38888888888741095749e-03 +
                  z * (2.48015872894767294178e-05 +
                       z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
    lanes half = 0.5 * z, w = 1.0 - half, cosine = w + (((1.0 - w) - half) + (z * p - r * tail));
    which odd = (quarter == 1.0) | (quarter == 3.0);
    lanes sign = pick(negative, fill(-1.0), fill(1.0));
    *cosines = pick(odd, sine, cosine) * pick((quarter == 1.0) | (quarter == 2.0), fill(-1.0), fill(1.0));
    *sines = pick(odd, cosine, sine) * pick(quarter >= 2.0, 0.0 - sign, sign);
}

static double angle_of(double y, double x) {
    static const double HIGH[] = {0.0, 4.63647609000806093515e-01, 7.85398163397448278999e-01, 9.82793723247329054082e-01,
                                  1.57079632679489655800e00};
    static const double LOW[] = {0.0, 2.26987774529616870924e-17, 3.06161699786838301793e-17, 1.39033110312309984516e-17,
                                 6.12323399573676603587e-17};
    double s = fabs(y) / fabs(x), t;
    int piece;
    if (fabs(x) == 0.0 && fabs(y) == 0.0) return 0.0;
    if (fabs(y) * 0x1p-60 > fabs(x)) return y < 0.0 ? -PI / 2.0 : PI / 2.0;
    if (s < 0.4375) piece = 0, t = s;
    else if (s < 0.6875) piece = 1, t = (2.0 * s - 1.0) / (2.0 + s);
    else if (s < 1.1875) piece = 2, t = (s - 1.0) / (s + 1.0);
    else if (s < 2.4375) piece = 3, t = (s - 1.5) / (1.0 + 1.5 * s);
    else piece = 4, t = -1.0 / s;
    double z = t * t, w = z * z;
    double odd = z * (3.33333333333329318027e-01 +
                      w * (1.42857142725034663711e-01 +
                           w * (9.09088713343650656196e-02 +
                                w * (6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)))));
    double even = w * (-1.99999999998764832476e-01 +
                       w * (-1.11111104054623557880e-01 +
                            w * (-7.69187620504482999495e-02 + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02))));
    double angle = HIGH[piece] - ((t * (odd + even) - LOW[piece]) - t);
    if (x < 0.0) angle = PI - (angle - 1.2246467991473531772e-16);
    return y < 0.0 ? -angle : angle;
}

/* ---- walls ---- */

static inline int first_near(double x, double y, double reach) {
    double free = free_radius - reach;
    return free > 0.0 && x * x + y * y < free * free ? walls : 0; /* all are outer walls */
}

static inline int is_near(const double *box, double x, double y, double reach) {
    double dx = x - box[CENTRE_X], dy = y - box[CENTRE_Y];
    double along = fabs(dx * box[WALL_COSINE] + dy * box[WALL_SINE]) - box[HALF_LENGTH];
    double across = fabs(dy * box[WALL_COSINE] - dx * box[WALL_SINE]) - box[HALF_WIDTH];
    return at_least(along, across) < reach;
}

static inline double square_to(const double *box, double x, double y) {
    double dx = x - box[CENTRE_X], dy = y - box[CENTRE_Y];
    double along = at_least(fabs(dx * box[WALL_COSINE] + dy * box[WALL_SINE]) - box[HALF_LENGTH], 0.0);
    double across = at_least(fabs(dy * box[WALL_COSINE] - dx * box[WALL_SINE]) - box[HALF_WIDTH], 0.0);
    return along * along + across * across;
}

static inline double to_box(const double *box, double x, double y, double dx, double dy) {
    double from_x = x - box[CENTRE_X], from_y = y - box[CENTRE_Y];
    double along = from_x * box[WALL_COSINE] + from_y * box[WALL_SINE];
    double across = from_y * box[WALL_COSINE] - from_x * box[WALL_SINE];
    double to_along = dx * box[WALL_COSINE] + dy * box[WALL_SINE], to_across = dy * box[WALL_COSINE] - dx * box[WALL_SINE];
    if (along < 0.0) along = -along, to_along = -to_along;
    if (across < 0.0) across = -across, to_across = -to_across;
    if (along > box[HALF_LENGTH] && to_along < 0.0) {
        double part = (box[HALF_LENGTH] - along) / to_along;
        if (part < 1.0 && fabs(across + part * to_across) <= box[HALF_WIDTH]) return part;
    }
    if (across > box[HALF_WIDTH] && to_across < 0.0) {
        double part = (box[HALF_WIDTH] - across) / to_across;
        if (part < 1.0 && fabs(along + part * to_along) <= box[HALF_LENGTH]) return part;
    }
    return 2.0;
}

/* ---- sensors ---- */

static inline void see_robot(int robot, double dx, double dy) {
    double ahead = dx * OF(COSINE)[robot] + dy * OF(SINE)[robot], aside = dy * OF(COSINE)[robot] - dx * OF(SINE)[robot];
    lanes along = table[RAY_X] * ahead + table[RAY_Y] * aside, across = table[RAY_X] * aside - table[RAY_Y] * ahead;
    lanes chord = RADIUS * RADIUS - across * across;
    which hit = chord > 0.0;
    lanes distance = along - roots(pick(hit, chord, fill(0.0))) - RING;
    hit = hit & (distance >= 0.0) & (distance < RAY);
    lanes value = (distance * (double)298.701f + (double)-36.8961f) * distance + (double)1.08212f;
    value = pick(value < 1.0, value, fill(1.0));
    rays[robot] = pick(hit & (value > rays[robot]), value, rays[robot]);
}

static inline int hidden(int robot, int other, double dx, double dy) {
    double x = OF(X)[robot], y = OF(Y)[robot], square = dx * dx + dy * dy;
    for (int at = 0; at < width; at++) {
        lanes third_x = rows[X][at] - x, third_y = rows[Y][at] - y;
        lanes along = third_x * dx + third_y * dy, across = third_y * dx - third_x * dy;
        lanes chord = RADIUS * RADIUS * square - across * across;
        which may = (chord > 0.0) & (along > 0.0) & (along < square + square) & (indices[at] != (double)other);
        if (to_bits(may)) {
            lanes crossing = along - roots(pick(may, chord, fill(0.0)) * square);
            if (to_bits(may & (crossing >= 0.0) & (crossing < square))) return 1;
        }
    }
    return 0;
}

static inline void hear(int robot, double dx, double dy, double distance) {
    double ahead = dx * OF(COSINE)[robot] + dy * OF(SINE)[robot], aside = dy * OF(COSINE)[robot] - dx * OF(SINE)[robot];
    OF(HEARD)[robot] += 1.0;
    if (aside == 0.0 && ahead > 0.0) return;
    double weight = 1.0 / (1.0 + (100.0 * distance - 7.0)) / distance;
    OF(HEARD_X)[robot] += weight * ahead;
    OF(HEARD_Y)[robot] += weight * aside;
}

static void meet(void) {
    const double reach = RING + RAY + RADIUS, lost = constants[LOSS];
    int nearby = 0, heard = 0, in_range = 0;
    for (int robot = 0; robot < number; robot++) {
        double x = OF(X)[robot], y = OF(Y)[robot];
        for (int at = (robot + 1) / LANES; at < width; at++) {
            lanes dx = rows[X][at] - x, dy = rows[Y][at] - y, squares = dx * dx + dy * dy;
            which later = indices[at] > (double)robot;
            for (int lane = 0; lane < LANES; lane++) near[nearby + lane] = audible[in_range + lane] = robot;
            nearby += list_true((squares < reach * reach) & later, at * LANES, beside + nearby);
            in_range += list_true((squares < hearing * hearing) & later, at * LANES, sender + in_range);
        }
    }
    for (int at = 0; at < nearby; at++) {
        int robot = near[at], other = beside[at];
        double dx = OF(X)[other] - OF(X)[robot], dy = OF(Y)[other] - OF(Y)[robot];
        see_robot(robot, dx, dy);
        see_robot(other, -dx, -dy);
    }
    for (int robot = 0; robot < number; robot++) {
        for (int sensor = 0; sensor < SENSORS; sensor++) OF(PROXIMITY + sensor)[robot] = rays[robot][sensor];
        rays[robot] = fill(0.0);
    }
    draw_uniforms(chances[0], MOST * MOST, 2, in_range);
    skip(2 * (uint64_t)in_range);
    for (int at = 0; at < in_range; at++) {
        received[heard] = at;
        heard += (chances[0][at] >= lost) | (chances[1][at] >= lost);
    }
    for (int index = 0; index < heard; index++) {
        int at = received[index], robot = audible[at], other = sender[at];
        double dx = OF(X)[other] - OF(X)[robot], dy = OF(Y)[other] - OF(Y)[robot];
        if (!hidden(robot, other, dx, dy)) {
            double distance = sqrt(dx * dx + dy * dy);
            if (chances[0][at] >= lost) hear(robot, dx, dy, distance);
            if (chances[1][at] >= lost) hear(other, -dx, -dy, distance);
        }
    }
}

static inline void see_walls(int robot) {
    double x = OF(X)[robot], y = OF(Y)[robot];
    for (int at = first_near(x, y, RING + RAY); at < walls; at++) {
        const double *box = wall + at * WALL_COLUMNS;
        if (!is_near(box, x, y, RING + RAY)) continue;
        double cosine = OF(COSINE)[robot], sine = OF(SINE)[robot];
        for (int sensor = 0; sensor < SENSORS; sensor++) {
            double ray_x = table[RAY_X][sensor] * cosine - table[RAY_Y][sensor] * sine;
            double ray_y = table[RAY_X][sensor] * sine + table[RAY_Y][sensor] * cosine;
            double part = to_box(box, x + RING * ray_x, y + RING * ray_y, RAY * ray_x, RAY * ray_y);
            if (part < 1.0) {
                double distance = part * RAY, *reading = &OF(PROXIMITY + sensor)[robot];
                double value = ((double)298.701f * distance + (double)-36.8961f) * distance + (double)1.08212f;
                *reading = at_least(*reading, at_most(value, 1.0));
            }
        }
    }
}

static inline void disturb(int row, int which_noise, int kind) {
    double most = constants[kind];
    for (int at = 0; at < width; at++) {
        lanes value = rows[row][at] + most * (2.0 * noise[which_noise][at] - 1.0);
        value = pick(value > 0.0, value, fill(0.0));
        rows[row][at] = pick(value < 1.0, value, fill(1.0));
    }
}

static inline int dimmed(int robot, double dx, double dy, double distance) {
    double x = OF(X)[robot], y = OF(Y)[robot], farthest = distance * 0.076 / constants[LAMP_Z], reach = farthest + RADIUS;
    for (int at = 0; at < width; at++) {
        lanes other_x = rows[X][at] - x, other_y = rows[Y][at] - y;
        which close = (other_x * other_x + other_y * other_y <= reach * reach) & (indices[at] != (double)robot);
        if (to_bits(close)) {
            lanes along = (other_x * dx + other_y * dy) / distance, across = (other_y * dx - other_x * dy) / distance;
            lanes chord = RADIUS * RADIUS - across * across;
            close = close & (chord > 0.0);
            lanes crossing = along - roots(pick(close, chord, fill(0.0)));
            if (to_bits(close & (crossing >= 0.0) & (crossing <= farthest))) return 1;
        }
    }
    double low = 0.08 / constants[LAMP_Z];
    for (int at = first_near(x + low * dx, y + low * dy, 0.0); at < walls; at++) {
        const double *box = wall + at * WALL_COLUMNS;
        if (to_box(box, x, y, dx, dy) * constants[LAMP_Z] <= box[WALL_HEIGHT]) return 1;
    }
    return 0;
}

static inline void see_lamp(int robot) {
    double dx = constants[LAMP_X] - OF(X)[robot], dy = constants[LAMP_Y] - OF(Y)[robot], square = dx * dx + dy * dy;
    OF(BRIGHTNESS)[robot] = OF(BEARING)[robot] = 0.0;
    if (dimmed(robot, dx, dy, sqrt(square))) return;
    double distance = sqrt(square + constants[LAMP_Z] * constants[LAMP_Z]) / constants[INTENSITY];
    if (distance <= 2.5) OF(BRIGHTNESS)[robot] = exponential(-2.0 * distance);
    OF(BEARING)[robot] = angle_of(dy, dx) - OF(ANGLE)[robot];
}

static inline void see_light(int sensor) {
    for (int at = 0; at < width; at++) {
        lanes off = (rows[BEARING][at] - table[ANGLES][sensor]) / (2.0 * PI);
        off = off - floors(off + 0.5);
        off = pick(off < 0.0, 0.0 - off, off) * (2.0 * PI);
        lanes value = rows[BRIGHTNESS][at] * (1.0 - 2.0 * off / PI);
        rows[LIGHT + sensor][at] = pick(off < 0.5 * PI, value, fill(0.0));
    }
}

static inline void see_floor(int sensor) {
    double aside = 0.009 * (sensor - 1);
    for (int at = 0; at < width; at++) {
        lanes x = rows[X][at] + 0.03 * rows[COSINE][at] - aside * rows[SINE][at];
        lanes y = rows[Y][at] + 0.03 * rows[SINE][at] + aside * rows[COSINE][at], grey = fill(127.0 / 255);
        for (int spot = places - 1; spot >= 0; spot--) {
            const double *here = place + spot * PLACE_COLUMNS;
            lanes dx = x - here[PLACE_X], dy = y - here[PLACE_Y];
            which in = here[SHAPE] == 0 ? dx * dx + dy * dy <= here[SIZE_X] * here[SIZE_X]
                                        : (dx < here[SIZE_X]) & (dx > -here[SIZE_X]) & (dy < here[SIZE_Y]) & (dy > -here[SIZE_Y]);
            grey = pick(in, fill(here[GREY]), grey);
        }
        rows[GROUND + sensor][at] = grey;
    }
}

static void sense(void) {
    for (int row = PROXIMITY; row <= HEARD_Y; row++)
        for (int at = 0; at < width; at++) rows[row][at] = fill(0.0);
    meet();
    draw_uniforms((double *)noise, MOST, NOISY, width * LANES);
    skip(NOISY * (uint64_t)number);
    for (int robot = 0; robot < number; robot++) see_walls(robot);
    for (int row = 0; row < SENSORS; row++) disturb(PROXIMITY + row, row, PROXIMITY_NOISE);
    if (constants[INTENSITY] > 0.0) {
        for (int robot = 0; robot < number; robot++) see_lamp(robot);
        for (int sensor = 0; sensor < SENSORS; sensor++) see_light(sensor);
    }
    for (int row = 0; row < SENSORS; row++) disturb(LIGHT + row, SENSORS + row, LIGHT_NOISE);
    for (int sensor = 0; sensor < 3; sensor++) {
        see_floor(sensor);
        disturb(GROUND + sensor, 2 * SENSORS + sensor, GROUND_NOISE);
    }
}

/* ---- reference model 1.2 ---- */

static inline void project(int first, int at, lanes x, lanes y, lanes factor) {
    for (int direction = 0; direction < 4; direction++) {
        lanes length = factor * (x * table[DIRECTIONS_X][direction] + y * table[DIRECTIONS_Y][direction]);
        seen[first + direction][at] = pick(length > 0.0, length, fill(0.0));
    }
}

static void interpret(void) {
    for (int at = 0; at < width; at++) {
        int slot = 2 * (step % MEMORY);
        memory[slot][at] = rows[HEARD_X][at];
        memory[slot + 1][at] = rows[HEARD_Y][at];
        lanes black = fill(0.0), white = fill(0.0), x = fill(0.0), y = fill(0.0), most = fill(0.0);
        for (int sensor = 0; sensor < 3; sensor++) {
            lanes reading = rows[GROUND + sensor][at];
            black = black + pick(reading < 0.03, fill(1.0), fill(0.0));
            white = white + pick(reading > 0.85, fill(1.0), fill(0.0));
        }
        slot = 2 * MEMORY + 2 * (step % VOTES);
        memory[slot][at] = black;
        memory[slot + 1][at] = white;
        for (int sensor = 0; sensor < SENSORS; sensor++) {
            lanes reading = rows[PROXIMITY + sensor][at];
            x = x + reading * table[ANGLES_X][sensor];
            y = y + reading * table[ANGLES_Y][sensor];
        }
        lanes length = roots(x * x + y * y);
        project(0, at, x, y, 1.0 / pick(length > 1.0, length, fill(1.0)));
        x = y = fill(0.0);
        for (int sensor = 0; sensor < SENSORS; sensor++) {
            lanes reading = rows[LIGHT + sensor][at];
            most = pick(reading > most, reading, most);
            x = x + reading * table[ANGLES_X][sensor];
            y = y + reading * table[ANGLES_Y][sensor];
        }
        length = roots(x * x + y * y);
        which shines = (most > 0.2) & (length > 0.0);
        project(4, at, x, y, pick(shines, 1.0 / pick(shines, length, fill(1.0)), fill(0.0)));
        x = y = fill(0.0);
        for (int old = 0; old < 2 * MEMORY; old += 2) {
            x = x + memory[old][at];
            y = y + memory[old + 1][at];
        }
        project(10, at, x, y, fill(1.0));
        black = white = fill(0.0);
        for (int old = 2 * MEMORY; old < 2 * (MEMORY + VOTES); old += 2) {
            black = black + memory[old][at];
            white = white + memory[old + 1][at];
        }
        seen[8][at] = pick(black > 10.0, fill(0.0), pick(white > 10.0, fill(1.0), fill(0.5)));
    }
    for (int robot = 0; robot < number; robot++) {
        float *to = observations[robot];
        for (int input = 0; input < INPUTS; input++) to[input] = (float)((double *)seen[input])[robot];
        if (to[8] == 0.5f) {
            double at = draw_uniform() * (QUANTILES - 1);
            int low = (int)at;
            to[8] = (float)(greys[low] + (at - low) * (greys[low + 1] - greys[low]));
        }
        to[9] = (float)(1.0 - 2.0 / (1.0 + exponential(OF(HEARD)[robot])));
    }
}

/* ---- network ---- */

static inline double sigmoid(double x) { return 1.0 / (1.0 + exponential(-x)); }

static void decide(const float *parameters) {
    const float *weights = parameters + HEADER, *biases = weights + INPUTS * LANES;
    for (int robot = 0; robot < number; robot++) {
        float left = 0, right = 0;
        for (int input = 0; input < INPUTS; input++) {
            left = left + weights[input * LANES] * observations[robot][input];
            right = right + weights[input * LANES + 1] * observations[robot][input];
        }
        actions[0][robot] = (float)sigmoid(biases[0] + left);
        actions[1][robot] = (float)sigmoid(biases[1] + right);
    }
}

/* ---- physics ---- */

static inline double at_speed(float output) {
    double positive = output > 0.0f ? output : 0.0, speed = (2.0 * at_most(positive, 1.0) - 1.0) * 12.0 * (double)0.01f;
    return constants[WHEEL_NOISE] > 0.0 ? speed * (1.0 + constants[WHEEL_NOISE] * draw_normal()) : speed;
}

static inline void turn(void) {
    for (int at = 0; at < width; at++) turned(rows[ANGLE][at], &rows[COSINE][at], &rows[SINE][at]);
}

static int list_pairs(void) {
    double fastest = 0.0;
    for (int robot = 0; robot < number; robot++) {
        double x = OF(SPEED_X)[robot], y = OF(SPEED_Y)[robot];
        fastest = at_least(fastest, x * x + y * y);
        x = OF(TARGET_X)[robot], y = OF(TARGET_Y)[robot];
        fastest = at_least(fastest, x * x + y * y);
    }
    double reach = RADIUS + 1.5 * 10 * SUBSTEP_S * sqrt(fastest), square = 4.0 * reach * reach;
    int found = 0;
    for (int robot = 0; robot < number; robot++) {
        double x = OF(X)[robot], y = OF(Y)[robot];
        for (int at = walls - 1, first = first_near(x, y, reach); at >= first; at--)
            if (is_near(wall + at * WALL_COLUMNS, x, y, reach)) pairs[found][0] = robot, pairs[found++][1] = number + at;
        for (int at = width - 1; at * LANES > robot - LANES; at--) {
            lanes dx = rows[X][at] - x, dy = rows[Y][at] - y;
            uint32_t bits = to_bits((dx * dx + dy * dy < square) & (indices[at] > (double)robot));
            for (; bits; bits &= ~(1u << (31 - __builtin_clz(bits)))) {
                pairs[found][0] = robot;
                pairs[found++][1] = at * LANES + 31 - __builtin_clz(bits);
            }
        }
    }
    return found;
}

static inline int meet_robot(int robot, int other, contact *to) {
    double dx = OF(X)[other] - OF(X)[robot], dy = OF(Y)[other] - OF(Y)[robot], square = dx * dx + dy * dy;
    if (!(square < (2.0 * RADIUS) * (2.0 * RADIUS))) return 0;
    double distance = sqrt(square);
    to->normal_x = distance > 0.0 ? dx / distance : 1.0;
    to->normal_y = distance > 0.0 ? dy / distance : 0.0;
    to->arm_x = dx * 0.5;
    to->arm_y = dy * 0.5;
    to->friction = BETWEEN_ROBOTS;
    return 1;
}

static inline int meet_wall(int robot, const double *box, contact *to) {
    double dx = OF(X)[robot] - box[CENTRE_X], dy = OF(Y)[robot] - box[CENTRE_Y];
    double cosine = box[WALL_COSINE], sine = box[WALL_SINE];
    double along = dx * cosine + dy * sine, across = dy * cosine - dx * sine;
    double beyond = fabs(along) - box[HALF_LENGTH], above = fabs(across) - box[HALF_WIDTH];
    if (at_least(beyond, above) >= RADIUS) return 0;
    double along_sign = along < 0.0 ? -1.0 : 1.0, across_sign = across < 0.0 ? -1.0 : 1.0, to_along, to_across, arm;
    if (beyond > 0.0 && above > 0.0) {
        double distance = sqrt(beyond * beyond + above * above);
        if (distance >= RADIUS) return 0;
        to_along = -along_sign * beyond / distance;
        to_across = -across_sign * above / distance;
        arm = 0.5 * (RADIUS + distance);
    } else {
        to_along = above >= beyond ? 0.0 : -along_sign;
        to_across = above >= beyond ? -across_sign : 0.0;
        arm = 0.5 * (RADIUS + at_least(beyond, above));
    }
    to->normal_x = to_along * cosine - to_across * sine;
    to->normal_y = to_along * sine + to_across * cosine;
    to->arm_x = to->normal_x * arm;
    to->arm_y = to->normal_y * arm;
    to->friction = WITH_WALL;
    return 1;
}

static inline int touch(int robot, int listed) {
    if (OF(TOUCHES)[robot] > 0.0) return listed;
    OF(TOUCHES)[robot] = 1.0;
    touching[listed] = robot;
    leaders[robot] = robot;
    levels[robot] = 0;
    return listed + 1;
}

static inline void push(double *body, const contact *c, double along, double across) {
    double x = c->normal_x * along - c->normal_y * across, y = c->normal_x * across + c->normal_y * along;
    double turning = PER_INERTIA * (c->arm_x * y - c->arm_y * x);
    body[BODY_X] -= x * PER_MASS;
    body[BODY_Y] -= y * PER_MASS;
    body[BODY_SPIN] -= turning;
}

static inline void push_apart(double *one, double *two, const contact *c, double along, double across) {
    double x = c->normal_x * along - c->normal_y * across, y = c->normal_x * across + c->normal_y * along;
    double turning = PER_INERTIA * (c->arm_x * y - c->arm_y * x);
    double one_x = one[BODY_X] - x * PER_MASS, one_y = one[BODY_Y] - y * PER_MASS, one_spin = one[BODY_SPIN] - turning;
    double two_x = two[BODY_X] + x * PER_MASS, two_y = two[BODY_Y] + y * PER_MASS, two_spin = two[BODY_SPIN] - turning;
    one[BODY_X] = one_x, one[BODY_Y] = one_y, one[BODY_SPIN] = one_spin;
    two[BODY_X] = two_x, two[BODY_Y] = two_y, two[BODY_SPIN] = two_spin;
}

static inline void changes(contact *c, double x, double y, double *along, double *across) {
    double old_along = c->along, old_across = c->across;
    double new_along = at_least(old_along - (x * c->normal_x + y * c->normal_y) * c->along_mass, 0.0);
    double most = c->friction * new_along, new_across = old_across - (y * c->normal_x - x * c->normal_y) * c->across_mass;
    new_across = at_most(at_least(new_across, -most), most);
    c->along = new_along;
    c->across = new_across;
    *along = new_along - old_along;
    *across = new_across - old_across;
}

static inline double part(double *one, double *two, contact *c) {
    double along, across, x = one[BODY_SPIN] * c->arm_y - one[BODY_X], y = -one[BODY_SPIN] * c->arm_x - one[BODY_Y];
    x += two[BODY_X] + two[BODY_SPIN] * c->arm_y;
    y += two[BODY_Y] - two[BODY_SPIN] * c->arm_x;
    changes(c, x, y, &along, &across);
    push_apart(one, two, c, along, across);
    return at_least(fabs(along), fabs(across));
}

static inline double stop(double *body, contact *c) {
    double along, across, x = body[BODY_SPIN] * c->arm_y - body[BODY_X], y = -body[BODY_SPIN] * c->arm_x - body[BODY_Y];
    changes(c, x, y, &along, &across);
    push(body, c, along, across);
    return at_least(fabs(along), fabs(across));
}

static inline double pull(double *body) {
    double old_x = body[MOTOR_X], old_y = body[MOTOR_Y], old_spin = body[MOTOR_SPIN];
    double x = old_x + MASS * (body[WANTED_X] - body[BODY_X]), y = old_y + MASS * (body[WANTED_Y] - body[BODY_Y]);
    double square = x * x + y * y;
    if (square > MOST_IMPULSE * MOST_IMPULSE) {
        double limited = MOST_IMPULSE / sqrt(square);
        x *= limited;
        y *= limited;
    }
    double spin = at_most(at_least(old_spin + INERTIA * (body[WANTED_SPIN] - body[BODY_SPIN]), -MOST_IMPULSE), MOST_IMPULSE);
    body[MOTOR_X] = x;
    body[MOTOR_Y] = y;
    body[MOTOR_SPIN] = spin;
    body[BODY_X] += (x - old_x) * PER_MASS;
    body[BODY_Y] += (y - old_y) * PER_MASS;
    body[BODY_SPIN] += (spin - old_spin) * PER_INERTIA;
    return at_least(at_least(fabs(x - old_x), fabs(y - old_y)), fabs(spin - old_spin));
}

static void weigh(int index) {
    contact *c = &contacts[index];
    const link *l = &links[index];
    impulse *last = &impulses[l->first * (number + walls) + l->second];
    double arm_along = c->arm_x * c->normal_y - c->arm_y * c->normal_x, arm_across = c->arm_x * c->normal_x + c->arm_y * c->normal_y;
    double along = PER_MASS + PER_INERTIA * arm_along * arm_along, across = PER_MASS + PER_INERTIA * arm_across * arm_across;
    if (l->second < number) along += along, across += across;
    c->along_mass = 1.0 / along;
    c->across_mass = 1.0 / across;
    int64_t gap = substep - last->touched;
    if (gap > 3) last->along = last->across = 0.0;
    c->along = last->along;
    c->across = last->across;
    last->touched = substep;
    if (gap != 1) return;
    if (l->second < number) push_apart(bodies[l->first], bodies[l->second], c, c->along, c->across);
    else push(bodies[l->first], c, c->along, c->across);
}

static void sort(int found) {
    int all = 0, start = 0;
    for (int index = 0; index < found; index++) {
        link *l = &links[index];
        int level = levels[l->first];
        if (l->second < number) {
            level = level > levels[l->second] ? level : levels[l->second];
            levels[l->second] = level + 1;
        }
        levels[l->first] = level + 1;
        l->level = level;
        if (level == all) level_starts[all++] = 0;
        level_starts[level]++;
    }
    for (int level = 0; level < all; level++) {
        int count = level_starts[level];
        level_starts[level] = start;
        start += count;
    }
    for (int index = 0; index < found; index++) order[level_starts[links[index].level]++] = index;
}

static inline int leader(int robot) {
    while (leaders[robot] != robot) robot = leaders[robot];
    return robot;
}

static int group(int found, int touched) {
    int all = 0;
    for (int index = 0; index < found; index++)
        if (links[index].second < number) {
            int one = leader(links[index].first), two = leader(links[index].second);
            leaders[one > two ? one : two] = one < two ? one : two;
        }
    for (int at = 0; at < touched; at++) {
        int robot = touching[at];
        if (leaders[robot] == robot) {
            groups[robot] = all;
            before[all] = 1.0;
            now[all++] = 0.0;
        }
    }
    for (int at = 0; at < touched; at++) {
        active[at] = touching[at];
        groups[touching[at]] = groups[leader(touching[at])];
    }
    for (int index = 0; index < found; index++) links[index].group = groups[links[index].first];
    return all;
}

static void settle(int found, int touched, int all) {
    for (int iteration = 0; iteration < 10; iteration++) {
        for (int at = 0; at < found; at++) {
            const link *l = &links[order[at]];
            contact *c = &contacts[order[at]];
            double change = l->second < number ? part(bodies[l->first], bodies[l->second], c) : stop(bodies[l->first], c);
            now[l->group] = at_least(now[l->group], change);
        }
        for (int at = 0; at < touched; at++) {
            double change = pull(bodies[active[at]]);
            now[groups[active[at]]] = at_least(now[groups[active[at]]], change);
        }
        int settled = 0;
        for (int each = 0; each < all; each++) {
            settled |= now[each] < SETTLED && before[each] >= SETTLED;
            before[each] = now[each];
            now[each] = 0.0;
        }
        if (!settled) continue;
        int left = 0, remaining = 0;
        for (int at = 0; at < found; at++) {
            order[left] = order[at];
            left += before[links[order[at]].group] >= SETTLED;
        }
        for (int at = 0; at < touched; at++) {
            active[remaining] = active[at];
            remaining += before[groups[active[at]]] >= SETTLED;
        }
        found = left;
        touched = remaining;
        if (touched == 0) break;
    }
}

static void solve(int found, int touched) {
    for (int at = 0; at < touched; at++) {
        int robot = touching[at];
        double *body = bodies[robot];
        for (int row = 0; row < 3; row++) {
            body[BODY_X + row] = OF(SPEED_X + row)[robot];
            body[MOTOR_X + row] = OF(PUSH_X + row)[robot];
            body[WANTED_X + row] = OF(TARGET_X + row)[robot];
        }
    }
    sort(found);
    for (int at = 0; at < found; at++) weigh(order[at]);
    for (int at = 0; at < touched; at++) {
        double *body = bodies[touching[at]];
        body[BODY_X] += body[MOTOR_X] * PER_MASS;
        body[BODY_Y] += body[MOTOR_Y] * PER_MASS;
        body[BODY_SPIN] += body[MOTOR_SPIN] * PER_INERTIA;
    }
    settle(found, touched, group(found, touched));
    for (int at = 0; at < found; at++) {
        impulse *last = &impulses[links[at].first * (number + walls) + links[at].second];
        last->along = contacts[at].along;
        last->across = contacts[at].across;
    }
    for (int at = 0; at < touched; at++) {
        int robot = touching[at];
        for (int row = 0; row < 3; row++) {
            OF(SPEED_X + row)[robot] = bodies[robot][BODY_X + row];
            OF(PUSH_X + row)[robot] = bodies[robot][MOTOR_X + row];
        }
        OF(TOUCHES)[robot] = 0.0;
    }
}

static inline void pull_free(void) {
    for (int at = 0; at < width; at++) {
        which free = rows[TOUCHES][at] == 0.0;
        lanes dx = rows[TARGET_X][at] - rows[SPEED_X][at], dy = rows[TARGET_Y][at] - rows[SPEED_Y][at];
        lanes square = dx * dx + dy * dy, turning = rows[TARGET_SPIN][at] - rows[SPIN][at];
        which over = square > MOST_CHANGE * MOST_CHANGE;
        if (to_bits(over)) {
            lanes share = pick(over, MOST_CHANGE / roots(pick(over, square, fill(1.0))), fill(1.0));
            dx = dx * share;
            dy = dy * share;
        }
        turning = pick(turning < -MOST_TURN, fill(-MOST_TURN), turning);
        turning = pick(turning > MOST_TURN, fill(MOST_TURN), turning);
        rows[SPEED_X][at] = pick(free, rows[SPEED_X][at] + dx, rows[SPEED_X][at]);
        rows[SPEED_Y][at] = pick(free, rows[SPEED_Y][at] + dy, rows[SPEED_Y][at]);
        rows[SPIN][at] = pick(free, rows[SPIN][at] + turning, rows[SPIN][at]);
        rows[PUSH_X][at] = pick(free, dx * MASS, rows[PUSH_X][at]);
        rows[PUSH_Y][at] = pick(free, dy * MASS, rows[PUSH_Y][at]);
        rows[PUSH_SPIN][at] = pick(free, turning * INERTIA, rows[PUSH_SPIN][at]);
    }
}

static void drive(void) {
    for (int at = 0; at < width; at++) {
        lanes speed = (rows[LEFT][at] + rows[RIGHT][at]) * 0.5;
        rows[TARGET_X][at] = speed * rows[COSINE][at];
        rows[TARGET_Y][at] = speed * rows[SINE][at];
        rows[TARGET_SPIN][at] = (rows[RIGHT][at] - rows[LEFT][at]) / WHEEL_DISTANCE;
    }
    int listed = list_pairs();
    for (int repeat = 0; repeat < 10; repeat++) {
        substep++;
        for (int at = 0; at < width; at++) {
            rows[X][at] += rows[SPEED_X][at] * SUBSTEP_S;
            rows[Y][at] += rows[SPEED_Y][at] * SUBSTEP_S;
            rows[ANGLE][at] += rows[SPIN][at] * SUBSTEP_S;
        }
        int found = 0, touched = 0;
        for (int index = 0; index < listed; index++) {
            int robot = pairs[index][0], other = pairs[index][1];
            if (other < number) {
                if (!meet_robot(robot, other, &contacts[found])) continue;
                touched = touch(other, touched);
            } else if (!meet_wall(robot, wall + (other - number) * WALL_COLUMNS, &contacts[found])) continue;
            touched = touch(robot, touched);
            links[found].first = robot;
            links[found++].second = other;
        }
        pull_free();
        if (found > 0) solve(found, touched);
    }
    turn();
}

/* ---- mission ---- */

static inline int within(double dx, double dy, double radius) { return dx * dx + dy * dy <= radius * radius; }

static void score(void) {
    for (int robot = 0; robot < number; robot++) {
        double x = OF(X)[robot], y = OF(Y)[robot];
        if (mission == AGGREGATION) {
            if (within(x, y - 0.6, 0.3)) total += 1.0;
        } else if (mission == FORAGING) {
            if (within(x - 0.75, y, 0.25) || within(x + 0.75, y, 0.25)) OF(CARRIES)[robot] = 1.0;
            else if (y <= -0.6) {
                total += OF(CARRIES)[robot];
                OF(CARRIES)[robot] = 0.0;
            }
        } else {
            int column = (int)floor(CELLS * (x / 2.50001 + 0.5)), row = (int)floor(CELLS * (y / 2.50001 + 0.5));
            if (column >= 0 && column < CELLS && row >= 0 && row < CELLS) cells[CELLS * row + column] = 0.0;
        }
    }
    if (mission == GRID_EXPLORATION)
        for (int cell = 0; cell < CELLS * CELLS; cell++) {
            total -= cells[cell];
            cells[cell] += 1.0;
        }
}

static int is_free(int robot) {
    double x = OF(X)[robot], y = OF(Y)[robot];
    for (int at = 0; at < walls; at++) {
        const double *box = wall + at * WALL_COLUMNS;
        if (x * box[CENTRE_X] + y * box[CENTRE_Y] > box[CENTRE_X] * box[CENTRE_X] + box[CENTRE_Y] * box[CENTRE_Y]) return 0;
    }
    for (int other = 0; other < number; other++) {
        double dx = OF(X)[other] - x, dy = OF(Y)[other] - y;
        if (other != robot && dx * dx + dy * dy < 4.0 * RADIUS * RADIUS) return 0;
    }
    for (int at = 0; at < walls; at++)
        if (square_to(wall + at * WALL_COLUMNS, x, y) < RADIUS * RADIUS) return 0;
    return 1;
}

static void start(uint64_t seed) {
    stream = seed;
    step = 1;
    substep = 0;
    total = hearings = 0.0;
    memset(rows, 0, sizeof rows);
    memset(memory, 0, sizeof memory);
    memset(cells, 0, sizeof cells);
    for (int at = 0; at < number * (number + walls); at++) impulses[at] = (impulse){0.0, 0.0, -1000};
    for (int robot = 0; robot < width * LANES; robot++) OF(X)[robot] = OF(Y)[robot] = 1e6;
    for (int robot = 0; robot < number; robot++) {
        OF(X)[robot] = around * (2.0 * draw_uniform() - 1.0);
        OF(Y)[robot] = around * (2.0 * draw_uniform() - 1.0);
    }
    for (int robot = 0; robot < number; robot++) do {
            double a = draw_uniform(), b = draw_uniform(), large = at_least(a, b), radius = large * around;
            lanes cosines, sines;
            turned(fill(large > 0.0 ? 2.0 * PI * (at_most(a, b) / large) : 0.0), &cosines, &sines);
            OF(X)[robot] = radius * cosines[0];
            OF(Y)[robot] = radius * sines[0];
            OF(ANGLE)[robot] = 2.0 * PI * draw_uniform();
        } while (!is_free(robot));
    turn();
    score();
}

/* parameters: rows of `row` float32 as the representation makes them, one for each trial. metrics: one for each. tables: TABLES
   rows of eight. */
void play(int64_t trials, int64_t steps, int64_t robots, int64_t which_mission, int64_t wall_rows, int64_t place_rows,
          const double *radii, const double *given, const double *boxes, const double *floor_rows, const double *readings,
          const double *tables, const float *parameters, int64_t row, const uint64_t *seeds, double *fitness, double *metrics) {
    for (int bits = 0; bits < 256; bits++)
        for (int lane = 0, next = 0; lane < LANES; lane++)
            if (bits >> lane & 1) set_bits[bits][next++] = lane;
    number = robots, width = (robots + LANES - 1) / LANES, mission = which_mission, walls = wall_rows, places = place_rows;
    hearing = radii[0], around = radii[1], free_radius = radii[2];
    constants = given, wall = boxes, place = floor_rows, greys = readings;
    memcpy(table, tables, sizeof table);
    for (int robot = 0; robot < MOST; robot++) ((double *)indices)[robot] = robot;
    for (int64_t trial = 0; trial < trials; trial++) {
        start(seeds[trial]);
        while (step <= steps) {
            sense();
            for (int robot = 0; robot < number; robot++) hearings += OF(HEARD)[robot];
            interpret();
            decide(parameters + trial * row);
            for (int robot = 0; robot < number; robot++) {
                OF(LEFT)[robot] = at_speed(actions[0][robot]);
                OF(RIGHT)[robot] = at_speed(actions[1][robot]);
            }
            if (++step > steps) break;
            drive();
            score();
        }
        fitness[trial] = mission == GRID_EXPLORATION ? total / (CELLS * CELLS) : total;
        metrics[trial] = hearings / (double)(steps * number);
    }
}
