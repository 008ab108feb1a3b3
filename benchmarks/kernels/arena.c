/* zswarm's arena, aggregation, with a fully-meshed tanh network of at most 8 neurons and one iteration: the same algorithm as
   zswarm/sims/arena*.py. With -O2 -ffp-contract=off it has the same bits. */

#include <math.h>
#include <stdint.h>
#include <string.h>

typedef float eight __attribute__((vector_size(32), aligned(4), may_alias));
typedef int32_t which __attribute__((vector_size(32)));
typedef float floats __attribute__((vector_size(32)));

#define MOST 1024 /* robots */
#define RAYS 8
#define INPUTS 10
#define NEURONS 8
#define HEADER 4
#define TINY 1e-6f
#define S 0.70710678f

enum { SIDE, SIGHT, RADIUS, HALF_STRIDE, HALF_TURN, CELLS_PER_METRE };

static const eight RAY_X = {1, S, 0, -S, -1, -S, 0, S};
static const eight RAY_Y = {0, S, 1, S, 0, -S, -1, -S};

static float x[MOST], y[MOST], heading_x[MOST], heading_y[MOST], push_x[MOST], push_y[MOST];
static float sorted_x[MOST + 8], sorted_y[MOST + 8], neighbours[MOST], seen[MOST][INPUTS + 6], state[MOST][NEURONS], action[MOST][2];
static int cell_of[MOST], order[MOST], near[MOST + 8], cells[MOST + 2];
static uint8_t set_bits[256][8]; /* of a byte, the lowest first */

static inline uint64_t draw_integer(uint64_t *stream, uint64_t bound) {
    uint64_t word = *stream += 0x9E3779B97F4A7C15u;
    word = (word ^ (word >> 30)) * 0xBF58476D1CE4E5B9u;
    word = (word ^ (word >> 27)) * 0x94D049BB133111EBu;
    word ^= word >> 31;
    return ((word >> 32) * bound) >> 32;
}

static inline float draw(uint64_t *stream, float low, float high) {
    return low + (float)draw_integer(stream, 1 << 24) * 0x1p-24f * (high - low);
}

static inline float cut(float o) {
    o = o > 0 ? o : 0;
    return o < 1 ? o : 1;
}

static inline float at_least(float number, float least) { return number > least ? number : least; }

static inline eight pick(which yes, eight a, eight b) { return (eight)((yes & (which)a) | (~yes & (which)b)); }

static inline eight all(float number) { return number - (eight){0}; }

static inline eight least(eight a, eight b) { return pick(a < b, a, b); }

static inline eight most(eight a, eight b) { return pick(a > b, a, b); }

static inline eight size(eight a) { return (eight)((which)a & 0x7fffffff); }

static inline eight roots(eight a) {
    eight made;
    for (int lane = 0; lane < 8; lane++) made[lane] = sqrtf(a[lane]);
    return made;
}

static const which COUNT = {0, 1, 2, 3, 4, 5, 6, 7};

static inline uint32_t to_bits(which yes) {
#ifdef __AVX__
    return __builtin_ia32_movmskps256((floats)yes);
#else
    uint32_t bits = 0;
    for (int lane = 0; lane < 8; lane++) bits |= (yes[lane] & 1u) << lane;
    return bits;
#endif
}

static void start(int robots, uint64_t seed, const float *lengths) {
    float low = lengths[RADIUS], high = lengths[SIDE] - lengths[RADIUS];
    for (int i = 0; i < robots; i++) {
        x[i] = draw(&seed, low, high);
        y[i] = draw(&seed, low, high);
        float h, k, square;
        do {
            h = draw(&seed, -1, 1);
            k = draw(&seed, -1, 1);
            square = h * h + k * k;
        } while (square > 1 || square < 0.01f);
        heading_x[i] = h / sqrtf(square);
        heading_y[i] = k / sqrtf(square);
    }
    memset(state, 0, sizeof state[0] * robots);
}

static void sort(int robots, int per_side, const float *lengths) {
    if (per_side == 1) {
        cells[0] = 0;
        cells[1] = robots;
        for (int i = 0; i < robots; i++) order[i] = i;
        memcpy(sorted_x, x, sizeof x[0] * robots);
        memcpy(sorted_y, y, sizeof y[0] * robots);
        return;
    }
    memset(cells, 0, sizeof cells[0] * (per_side * per_side + 2));
    for (int i = 0; i < robots; i++) {
        int column = (int)(x[i] * lengths[CELLS_PER_METRE]), row = (int)(y[i] * lengths[CELLS_PER_METRE]);
        column = column < per_side - 1 ? column : per_side - 1;
        row = row < per_side - 1 ? row : per_side - 1;
        cell_of[i] = row * per_side + column;
        cells[cell_of[i] + 2]++;
    }
    for (int cell = 2; cell < per_side * per_side + 2; cell++) cells[cell] += cells[cell - 1];
    for (int i = 0; i < robots; i++) {
        int at = cells[cell_of[i] + 1]++;
        order[at] = i;
        sorted_x[at] = x[i];
        sorted_y[at] = y[i];
    }
}

static inline int meet(int i, int found, const float *lengths) {
    const float px = x[i], py = y[i], h = heading_x[i], k = heading_y[i];
    const float sight = lengths[SIGHT], disc = lengths[RADIUS] * lengths[RADIUS], touch = lengths[RADIUS] + lengths[RADIUS];
    const float to_right = lengths[SIDE] - px, to_bottom = lengths[SIDE] - py;
    float sum_x = 0, sum_y = 0, pushed_x = 0, pushed_y = 0;
    int contacts = 0;
    const eight along_x = h * RAY_X - k * RAY_Y, along_y = k * RAY_X + h * RAY_Y;
    const eight wall_x = pick(along_x > 0, all(to_right), all(px)) / most(size(along_x), all(TINY));
    const eight wall_y = pick(along_y > 0, all(to_bottom), all(py)) / most(size(along_y), all(TINY));
    eight reach = least(least(wall_x, wall_y), all(sight));
    for (int n = 0; n < found; n++) {
        float dx = sorted_x[near[n]] - px, dy = sorted_y[near[n]] - py;
        float ahead = dx * h + dy * k, aside = dy * h - dx * k, square = dx * dx + dy * dy;
        sum_x += ahead;
        sum_y += aside;
        eight centre = ahead * RAY_X + aside * RAY_Y, off = aside * RAY_X - ahead * RAY_Y, chord = disc - off * off;
        eight hit = centre - roots(most(chord, all(0)));
        reach = least(pick((chord > 0) & (centre > 0), hit, all(sight)), reach);
        if (square < touch * touch) {
            float distance = sqrtf(square), share = 0.5f * (touch - distance) / at_least(distance, TINY);
            contacts++;
            pushed_x -= share * dx;
            pushed_y -= share * dy;
        }
    }
    float per_sight = 1 / sight, number = found > 0 ? found : 1;
    *(eight *)seen[i] = 1 - reach * per_sight;
    seen[i][RAYS] = sum_x * (per_sight / number);
    seen[i][RAYS + 1] = sum_y * (per_sight / number);
    push_x[i] = pushed_x;
    push_y[i] = pushed_y;
    neighbours[i] = found;
    return contacts;
}

static int look(int robots, int per_side, const float *lengths) {
    const float square = lengths[SIGHT] * lengths[SIGHT];
    int contacts = 0;
    sort(robots, per_side, lengths);
    for (int row = 0; row < per_side; row++)
        for (int column = 0; column < per_side; column++)
            for (int place = cells[row * per_side + column]; place < cells[row * per_side + column + 1]; place++) {
                const float px = sorted_x[place], py = sorted_y[place];
                int found = 0;
                for (int other = row > 0 ? row - 1 : 0; other < row + 2 && other < per_side; other++) {
                    int first = other * per_side + (column > 0 ? column - 1 : 0);
                    int last = other * per_side + (column + 1 < per_side ? column + 1 : per_side - 1);
                    for (int at = cells[first]; at < cells[last + 1]; at += 8) {
                        eight dx = *(eight *)(sorted_x + at) - px, dy = *(eight *)(sorted_y + at) - py;
                        which close = (dx * dx + dy * dy < square) & (COUNT < cells[last + 1] - at) & (COUNT != place - at);
                        uint32_t bits = to_bits(close);
                        for (int lane = 0; lane < 8; lane++) near[found + lane] = at + set_bits[bits][lane];
                        found += __builtin_popcount(bits);
                    }
                }
                contacts += meet(order[place], found, lengths);
            }
    return contacts;
}

static inline void decide(const float *parameters, const float *input, float *output, float *act) {
    const int neurons = parameters[2];
    const eight *weights = (const eight *)(parameters + HEADER);
    eight sum = {0};
    for (int source = 0; source < INPUTS; source++) sum += weights[source] * input[source];
    for (int source = 0; source < neurons; source++) sum += weights[INPUTS + source] * output[source];
    sum = weights[INPUTS + neurons] + sum;
    eight positive = least(pick(sum < 0, 0 - sum, sum), all(20));
    eight root = 1 + positive * (0.49962949f + positive * (0.12714170f + positive * (0.01738343f + positive * 0.00450478f)));
    eight power = root * root, tanh = 1 - 2 / (power * power + 1);
    *(eight *)output = pick(sum < 0, 0 - tanh, tanh);
    act[0] = output[neurons - 2];
    act[1] = output[neurons - 1];
}

static void measure(int robots, double *first, double *second) {
    float middle_x = 0, middle_y = 0, spread = 0, near_by = 0;
    for (int i = 0; i < robots; i++) middle_x += x[i], middle_y += y[i];
    middle_x /= robots;
    middle_y /= robots;
    for (int i = 0; i < robots; i++) {
        float dx = x[i] - middle_x, dy = y[i] - middle_y;
        spread += sqrtf(dx * dx + dy * dy);
        near_by += neighbours[i];
    }
    *first += spread / robots;
    *second += near_by / robots;
}

static void drive(int robots, const float *lengths) {
    const float low = lengths[RADIUS], high = lengths[SIDE] - lengths[RADIUS];
    for (int i = 0; i < robots; i++) {
        float left = 2 * cut(action[i][0]) - 1, right = 2 * cut(action[i][1]) - 1;
        float t = (right - left) * lengths[HALF_TURN], forward = (left + right) * lengths[HALF_STRIDE];
        float per_square = 1 / (1 + t * t), cosine = (1 - t * t) * per_square, sine = (t + t) * per_square;
        float h = cosine * heading_x[i] - sine * heading_y[i], k = cosine * heading_y[i] + sine * heading_x[i];
        float per_length = 1.5f - 0.5f * (h * h + k * k);
        h *= per_length;
        k *= per_length;
        float to_x = at_least(x[i] + forward * h + push_x[i], low), to_y = at_least(y[i] + forward * k + push_y[i], low);
        x[i] = to_x < high ? to_x : high;
        y[i] = to_y < high ? to_y : high;
        heading_x[i] = h;
        heading_y[i] = k;
    }
}

/* parameters: rows of `row` float32 as the representation makes them, one for each trial. metrics: three for each. */
void play(int64_t trials, int64_t steps, int64_t robots, int64_t per_side, const float *lengths, const float *parameters,
          int64_t row, const uint64_t *seeds, double *fitness, double *metrics) {
    for (int bits = 0; bits < 256; bits++)
        for (int lane = 0, next = 0; lane < 8; lane++)
            if (bits >> lane & 1) set_bits[bits][next++] = lane;
    for (int64_t trial = 0; trial < trials; trial++) {
        double first = 0, second = 0, contacts = 0, measured = 0;
        start(robots, seeds[trial], lengths);
        for (int64_t step = 1; step <= steps; step++) {
            contacts += look(robots, per_side, lengths);
            for (int i = 0; i < robots; i++) decide(parameters + trial * row, seen[i], state[i], action[i]);
            if (2 * step > steps) {
                measured++;
                measure(robots, &first, &second);
            }
            drive(robots, lengths);
        }
        fitness[trial] = 1.0 - first / measured / (0.3826 * (double)lengths[SIDE]);
        metrics[3 * trial] = first / measured;
        metrics[3 * trial + 1] = second / measured;
        metrics[3 * trial + 2] = contacts / 2.0 / (double)steps;
    }
}
