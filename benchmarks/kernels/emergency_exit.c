/* zswarm's emergency-exit with a fully-meshed network of two hidden neurons, two iterations and clamp: the same algorithm as
   zswarm/sims/emergency_exit.py, one trial after the other or eight side by side. With -O2 -ffp-contract=off both have the same
   bits. Fields come laid out, as zswarm has them: the free cells, way to the exit of each cell, first cells of the agents. */

#include <math.h>
#include <stdint.h>
#include <string.h>
#ifdef __AVX__
#include <immintrin.h>
#endif

typedef float four __attribute__((vector_size(16), aligned(4), may_alias));
typedef float eight __attribute__((vector_size(32), aligned(4), may_alias));
typedef int32_t which __attribute__((vector_size(32), aligned(4), may_alias));
typedef int32_t which_of_four __attribute__((vector_size(16)));

#define MOST_AGENTS 1024
#define MOST_CELLS 4096
#define LANES 8
#define INPUTS 10
#define NEURONS 4
#define SOURCES (INPUTS + NEURONS)
#define HEADER 4
#define PADDED 8 /* numbers of a source in the parameters */
#define ITERATIONS 2

static float grid[LANES * MOST_CELLS + 4]; /* 1 where a cell is free; windows of the last cells reach behind them */

static double far(double x, double y) { return sqrt(x * x + y * y); }

static void judge(double total, int64_t escaped, int64_t first_all_out, int64_t steps, double *fitness, double *metrics) {
    *fitness = (double)(steps - first_all_out) / (double)steps - total;
    metrics[0] = escaped;
    metrics[1] = first_all_out + 1 < steps ? first_all_out + 1 : steps;
}

/* ---- one trial after the other: the four neurons side by side ---- */

static inline int turn(float output) {
    float moved = 2 * output - 1;
    return (moved >= 0.5f && moved < 1.5f) - (moved < -0.5f && moved >= -1.5f);
}

static inline four cut_four(four sum) {
    sum = (four)(~(which_of_four)(sum < 0) & (which_of_four)sum);
    which_of_four above = sum > 1;
    return (four)((above & (which_of_four)((four){0} + 1)) | (~above & (which_of_four)sum));
}

static inline four decide_four(const float *parameters, const float *exit, const float *at, int64_t stride, four state) {
    const float *weights = parameters + HEADER;
    const float input[INPUTS] = {exit[0],        exit[1], at[-stride],     at[-stride + 1], at[1],
                                 at[stride + 1], at[stride], at[stride - 1], at[-1],          at[-stride - 1]};
    four from_inputs = *(const four *)weights * input[0];
    for (int source = 1; source < INPUTS; source++) from_inputs += *(const four *)(weights + source * PADDED) * input[source];
    for (int iteration = 0; iteration < ITERATIONS; iteration++) {
        four sum = from_inputs;
        for (int neuron = 0; neuron < NEURONS; neuron++)
            sum += *(const four *)(weights + (INPUTS + neuron) * PADDED) * state[neuron];
        state = cut_four(*(const four *)(weights + SOURCES * PADDED) + sum);
    }
    return state;
}

void play(int64_t trials, int64_t steps, int64_t agents, int64_t stride, int64_t count, const float *free, const float *to_exit,
          const int32_t *starts, const int64_t *field_of_trial, const float *parameters, int64_t row, double *fitness,
          double *metrics) {
    static int32_t cells[MOST_AGENTS];
    static uint8_t inside[MOST_AGENTS];
    static four states[MOST_AGENTS];
    for (int64_t trial = 0; trial < trials; trial++) {
        const int64_t field = field_of_trial[trial];
        const float *exits = to_exit + field * (2 * count + 2), *controller = parameters + trial * row;
        memcpy(grid, free + field * count, sizeof(float) * count);
        memcpy(cells, starts + field * agents, sizeof cells[0] * agents);
        memset(states, 0, sizeof states[0] * agents);
        memset(inside, 1, agents);
        for (int64_t agent = 0; agent < agents; agent++) grid[cells[agent]] = 0;
        int64_t remaining = agents, round = 0;
        for (; round < steps; round++) {
            for (int64_t agent = 0; agent < agents; agent++) {
                if (!inside[agent]) continue;
                const int32_t here = cells[agent];
                const four state = decide_four(controller, exits + 2 * here, grid + here, stride, states[agent]);
                states[agent] = state;
                int32_t there = here + turn(state[NEURONS - 1]) * (int32_t)stride + turn(state[NEURONS - 2]);
                there = grid[there] == 0 ? here : there;
                const int stays = exits[2 * there] != 0 || exits[2 * there + 1] != 0;
                grid[here] = 1;
                grid[there] = !stays;
                cells[agent] = there;
                inside[agent] = stays;
                remaining -= !stays;
            }
            if (remaining == 0) break;
        }
        double total = 0;
        for (int64_t agent = 0; agent < agents; agent++) total += far(exits[2 * cells[agent]], exits[2 * cells[agent] + 1]);
        judge(total, agents - remaining, round, steps, fitness + trial, metrics + 2 * trial);
    }
}

/* ---- eight trials side by side, each in a lane with a grid of its own ---- */

static inline eight all(float number) { return number - (eight){0}; }

static inline eight pick(which yes, eight a, eight b) { return (eight)((yes & (which)a) | (~yes & (which)b)); }

static inline int any(which yes) {
#ifdef __AVX__
    return !_mm256_testz_si256((__m256i)yes, (__m256i)yes);
#else
    int32_t some = 0;
    for (int lane = 0; lane < LANES; lane++) some |= yes[lane];
    return some;
#endif
}

/* Each lane's numbers at its place + offset, + 1, + 2: four are loaded at once, then rows become columns. */
static inline void window(const float *table, which places, int64_t offset, eight *first, eight *second, eight *third) {
    four rows[LANES];
    for (int lane = 0; lane < LANES; lane++) rows[lane] = *(const four *)(table + places[lane] + offset);
    eight pairs[4];
    for (int lane = 0; lane < 4; lane++)
        pairs[lane] = __builtin_shufflevector(rows[lane], rows[lane + 4], 0, 1, 2, 3, 4, 5, 6, 7);
    const eight left = __builtin_shufflevector(pairs[0], pairs[1], 0, 8, 1, 9, 4, 12, 5, 13);
    const eight right = __builtin_shufflevector(pairs[2], pairs[3], 0, 8, 1, 9, 4, 12, 5, 13);
    *first = __builtin_shufflevector(left, right, 0, 1, 8, 9, 4, 5, 12, 13);
    *second = __builtin_shufflevector(left, right, 2, 3, 10, 11, 6, 7, 14, 15);
    const eight left_third = __builtin_shufflevector(pairs[0], pairs[1], 2, 10, 3, 11, 6, 14, 7, 15);
    const eight right_third = __builtin_shufflevector(pairs[2], pairs[3], 2, 10, 3, 11, 6, 14, 7, 15);
    *third = __builtin_shufflevector(left_third, right_third, 0, 1, 8, 9, 4, 5, 12, 13);
}

static inline void decide(const eight weights[SOURCES + 1][NEURONS], const eight *input, eight *state) {
    eight from_inputs[NEURONS], sum[NEURONS];
    for (int neuron = 0; neuron < NEURONS; neuron++) from_inputs[neuron] = weights[0][neuron] * input[0];
    for (int source = 1; source < INPUTS; source++)
        for (int neuron = 0; neuron < NEURONS; neuron++) from_inputs[neuron] += weights[source][neuron] * input[source];
    for (int iteration = 0; iteration < ITERATIONS; iteration++) {
        for (int neuron = 0; neuron < NEURONS; neuron++) sum[neuron] = from_inputs[neuron];
        for (int source = 0; source < NEURONS; source++)
            for (int neuron = 0; neuron < NEURONS; neuron++) sum[neuron] += weights[INPUTS + source][neuron] * state[source];
        for (int neuron = 0; neuron < NEURONS; neuron++) {
            const eight whole = weights[SOURCES][neuron] + sum[neuron], positive = pick(whole < 0, all(0), whole);
            state[neuron] = pick(positive > 1, all(1), positive);
        }
    }
}

static inline void turned(eight output, which *back, which *forth) {
    const eight moved = 2 * output - 1;
    *back = (moved < -0.5f) & (moved >= -1.5f);
    *forth = (moved >= 0.5f) & (moved < 1.5f);
}

void play_eight(int64_t trials, int64_t steps, int64_t agents, int64_t stride, int64_t count, const float *free,
                const float *to_exit, const int32_t *starts, const int64_t *field_of_trial, const float *parameters, int64_t row,
                double *fitness, double *metrics) {
    static which cells[MOST_AGENTS];
    static eight exit_x[MOST_AGENTS], exit_y[MOST_AGENTS], states[MOST_AGENTS][NEURONS], weights[SOURCES + 1][NEURONS];
    const int64_t size = 2 * count + 2;
    for (int64_t first = 0; first < trials; first += LANES) {
        which offset, remaining = (which){0} + (int32_t)agents, first_out = (which){0} + (int32_t)steps;
        for (int lane = 0; lane < LANES; lane++) { /* the last trial is in the lanes that are left */
            const int64_t trial = first + lane < trials ? first + lane : trials - 1, field = field_of_trial[trial];
            for (int source = 0; source < SOURCES + 1; source++)
                for (int neuron = 0; neuron < NEURONS; neuron++)
                    weights[source][neuron][lane] = parameters[trial * row + HEADER + source * PADDED + neuron];
            memcpy(grid + lane * count, free + field * count, sizeof(float) * count);
            offset[lane] = field * size - 2 * lane * count;
            for (int64_t agent = 0; agent < agents; agent++) {
                const int32_t cell = starts[field * agents + agent];
                grid[lane * count + cell] = 0;
                cells[agent][lane] = lane * count + cell;
                exit_x[agent][lane] = to_exit[field * size + 2 * cell];
                exit_y[agent][lane] = to_exit[field * size + 2 * cell + 1];
            }
        }
        memset(states, 0, sizeof states[0] * agents);
        for (int32_t round = 0; round < steps; round++) {
            for (int64_t agent = 0; agent < agents; agent++) {
                const which inside = (exit_x[agent] != 0) | (exit_y[agent] != 0), here = cells[agent];
                if (!any(inside)) continue;
                eight nw, n, ne, w, middle, e, sw, s, se, there_x, there_y, unused;
                window(grid, here, -stride - 1, &nw, &n, &ne);
                window(grid, here, -1, &w, &middle, &e);
                window(grid, here, stride - 1, &sw, &s, &se);
                const eight input[INPUTS] = {exit_x[agent], exit_y[agent], n, ne, e, se, s, sw, w, nw};
                decide(weights, input, states[agent]);
                which west, east, up, down;
                turned(states[agent][NEURONS - 2], &west, &east);
                turned(states[agent][NEURONS - 1], &up, &down);
                const eight left = pick(up, nw, pick(down, sw, w)), right = pick(up, ne, pick(down, se, e));
                const eight same = pick(up, n, pick(down, s, all(0)));
                const which moves = inside & (pick(east, right, pick(west, left, same)) != 0);
                const which way = (up - down) * (int32_t)stride + west - east; /* true is -1 */
                const which there = here + (moves & way);
                window(to_exit, there + there + offset, 0, &there_x, &there_y, &unused);
                const which stays = (there_x != 0) | (there_y != 0);
                for (int lane = 0; lane < LANES; lane++) grid[here[lane]] = 1;
                const eight left_free = pick(stays, all(0), all(1));
                for (int lane = 0; lane < LANES; lane++) grid[there[lane]] = left_free[lane];
                cells[agent] = there;
                exit_x[agent] = there_x;
                exit_y[agent] = there_y;
                remaining += inside - stays;
            }
            const which out = (remaining == 0) & (first_out == (int32_t)steps);
            first_out = (out & round) | (~out & first_out);
            if (!any(remaining != 0)) break;
        }
        for (int lane = 0; lane < LANES && first + lane < trials; lane++) {
            double total = 0;
            for (int64_t agent = 0; agent < agents; agent++) total += far(exit_x[agent][lane], exit_y[agent][lane]);
            judge(total, agents - remaining[lane], first_out[lane], steps, fitness + first + lane, metrics + 2 * (first + lane));
        }
    }
}
