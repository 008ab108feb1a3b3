/* FREVO's emergency exit on a grid: a second implementation of zswarm/sims/emergency_exit.py, from its reference. */

#include "zswarm_wrapper.h"

enum { FIELD, STEPS, WIDTH, HEIGHT, AGENTS, EXITS, BLOCKADES, SEED, SETTINGS };

#define MOST 1000
#define STADIUM_SIZE 20

struct cell {
    int free;          /* not blocked and without an agent */
    int exit_x, exit_y; /* the way to the nearest exit */
};
struct place { int x, y; };

static const char *const FIELDS[] = {"random", "stadium", NULL};
static struct zswarm_setting settings[SETTINGS] = {
    [FIELD] = {.name = "field", .type = ZSWARM_TEXT, .text = "random", .choices = FIELDS,
               .description = "fields drawn from the trial's seed, or FREVO's stadium with 72 agents"},
    [STEPS] = {.name = "steps", .number = 50, .minimum = 1, .maximum = 1e6, .description = "rounds of a trial"},
    [WIDTH] = {.name = "width", .number = 20, .minimum = 1, .maximum = MOST, .description = "cells of a random field"},
    [HEIGHT] = {.name = "height", .number = 20, .minimum = 1, .maximum = MOST, .description = "cells of a random field"},
    [AGENTS] = {.name = "agents", .number = 10, .minimum = 1, .maximum = MOST, .description = "robots of a random field"},
    [EXITS] = {.name = "exits", .number = 5, .minimum = 1, .maximum = 1e4, .description = "exits of a random field"},
    [BLOCKADES] = {.name = "blockades", .number = 20, .minimum = 0, .maximum = 1e4,
                   .description = "blocked cells of a random field"},
    [SEED] = {.name = "seed", .number = 0, .minimum = 0, .maximum = 281474976710655.0,
              .description = "of the first field; the trials have `seed`, `seed` + 1, ..."},
};
static const char *const METRICS[] = {"escaped", "rounds", NULL};
static const char *const SENSORS[] = {"exit_dx", "exit_dy", "n", "ne", "e", "se", "s", "sw", "w", "nw", NULL};
static const char *const ACTUATORS[] = {"vx", "vy", NULL};

static int width, height, steps, agents, exits, blockades, stadium;
static char map[STADIUM_SIZE][STADIUM_SIZE + 1];
static struct place *stadium_starts, *starts, *exit_places;
static struct cell *cells;     /* surrounded by a ring of cells that are not free */
static struct cell **here;     /* each agent's cell */
static char *inside;           /* whether each agent is still in the room */
static int round_, next_agent, first_all_out, remaining;

static struct zswarm_simulator emergency_exit; /* below */

static void *room_for(void *old, size_t count, size_t size) {
    void *room = realloc(old, count * size);
    if (!room) {
        fprintf(stderr, "no memory is left\n");
        exit(1);
    }
    return room;
}

static int number(int setting) { return (int)settings[setting].number; }

static struct cell *cell_at(int x, int y) { return cells + (size_t)(y + 1) * (size_t)(width + 2) + x + 1; }

/* Read the stadium's map, then the agents' cells in their order. */
static const char *read_stadium(void) {
    FILE *file = fopen("../stadium.txt", "r");
    if (!file) return "../stadium.txt cannot be read";
    for (int y = 0; y < height; y++)
        if (fscanf(file, "%20s", map[y]) != 1) return fclose(file), "../stadium.txt has too few rows";
    struct place place;
    for (agents = 0; fscanf(file, "%d,%d", &place.x, &place.y) == 2; agents++) {
        stadium_starts = room_for(stadium_starts, (size_t)agents + 1, sizeof place);
        stadium_starts[agents] = place;
    }
    fclose(file);
    exits = 0;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) exits += map[y][x] == 'E';
    return NULL;
}

static const char *setup(void) {
    stadium = !strcmp(settings[FIELD].text, "stadium");
    steps = number(STEPS);
    width = stadium ? STADIUM_SIZE : number(WIDTH);
    height = stadium ? STADIUM_SIZE : number(HEIGHT);
    agents = number(AGENTS), exits = number(EXITS), blockades = number(BLOCKADES);
    if (stadium) {
        const char *refusal = read_stadium();
        if (refusal) return refusal;
    } else {
        if (width > height) return "width must not exceed height: a random field draws both coordinates from the width";
        if (agents + exits + blockades > width * width) return "agents, exits and blockades do not fit on width x width cells";
    }
    cells = room_for(cells, (size_t)(width + 2) * (size_t)(height + 2), sizeof *cells);
    starts = room_for(starts, (size_t)agents, sizeof *starts);
    exit_places = room_for(exit_places, (size_t)exits, sizeof *exit_places);
    here = room_for(here, (size_t)agents, sizeof *here);
    inside = room_for(inside, (size_t)agents, 1);
    emergency_exit.agents = agents;
    emergency_exit.first_seed = (int64_t)settings[SEED].number;
    return NULL;
}

/* java.util.Random.nextInt */
static int draw(uint64_t *state, int bound) {
    for (;;) {
        *state = (*state * 0x5DEECE66Du + 0xB) & 0xFFFFFFFFFFFFu;
        const int64_t bits = (int64_t)(*state >> 17), value = bits % bound;
        if ((bound & (bound - 1)) == 0) return (int)(bound * bits >> 31);
        if (bits - value + (bound - 1) < 2147483648) return (int)value;
    }
}

/* Draw a free cell and occupy it. */
static struct place take(uint64_t *state) {
    struct place place;
    do {
        place.x = draw(state, width);
        place.y = draw(state, width);
    } while (!cell_at(place.x, place.y)->free);
    cell_at(place.x, place.y)->free = 0;
    return place;
}

static void reset(uint64_t seed) {
    uint64_t state = (seed ^ 0x5DEECE66Du) & 0xFFFFFFFFFFFFu;
    memset(cells, 0, (size_t)(width + 2) * (size_t)(height + 2) * sizeof *cells);
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) cell_at(x, y)->free = 1;
    if (stadium) {
        int exit_ = 0;
        for (int y = 0; y < height; y++)
            for (int x = 0; x < width; x++) {
                if (map[y][x] == 'E') exit_places[exit_++] = (struct place){x, y};
                cell_at(x, y)->free = map[y][x] != '#';
            }
        memcpy(starts, stadium_starts, (size_t)agents * sizeof *starts);
    } else {
        for (int i = 0; i < agents; i++) starts[i] = take(&state);
        for (int i = 0; i < exits; i++) exit_places[i] = take(&state);
        for (int i = 0; i < blockades; i++) take(&state);
        for (int i = 0; i < exits; i++) cell_at(exit_places[i].x, exit_places[i].y)->free = 1;
    }
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            int nearest = INT32_MAX;
            for (int i = 0; i < exits; i++) { /* the first of equals */
                const int dx = exit_places[i].x - x, dy = exit_places[i].y - y, square = dx * dx + dy * dy;
                if (square < nearest) {
                    nearest = square;
                    cell_at(x, y)->exit_x = dx;
                    cell_at(x, y)->exit_y = dy;
                }
            }
        }
    for (int i = 0; i < agents; i++) {
        here[i] = cell_at(starts[i].x, starts[i].y);
        here[i]->free = 0;
        inside[i] = 1;
    }
    round_ = next_agent = 0;
    first_all_out = steps;
    remaining = agents;
}

/* Agents act one after another; those that have left are skipped. */
static int turn(int *acting) {
    for (; round_ < steps && remaining; round_++, next_agent = 0)
        while (next_agent < agents)
            if (inside[next_agent++]) return acting[0] = next_agent - 1, 1;
    return 0;
}

static void observe(int agent, float *observation) {
    const struct cell *cell = here[agent];
    const int row = width + 2, around[] = {-row, -row + 1, 1, row + 1, row, row - 1, -1, -row - 1};
    observation[0] = (float)cell->exit_x;
    observation[1] = (float)cell->exit_y;
    for (int i = 0; i < 8; i++) observation[2 + i] = (float)cell[around[i]].free;
}

static int velocity(float output) {
    const float moved = 2 * output - 1;
    return (moved >= 0.5f && moved < 1.5f) - (moved < -0.5f && moved >= -1.5f);
}

static void act(int agent, const float *action) {
    struct cell *there = here[agent] + velocity(action[1]) * (width + 2) + velocity(action[0]);
    if (!there->free) there = here[agent];
    here[agent]->free = 1;
    here[agent] = there;
    if (there->exit_x || there->exit_y) {
        there->free = 0;
        return;
    }
    inside[agent] = 0;
    if (--remaining == 0) first_all_out = round_;
}

static void judge(double *fitness, double *metrics) {
    double distances = 0;
    for (int i = 0; i < agents; i++) {
        const double x = here[i]->exit_x, y = here[i]->exit_y;
        distances += sqrt(x * x + y * y);
    }
    fitness[0] = (double)(steps - first_all_out) / steps - distances;
    metrics[0] = agents - remaining;
    metrics[1] = first_all_out + 1 < steps ? first_all_out + 1 : steps;
}

static struct zswarm_simulator emergency_exit = {
    .description = "Robots in a room must leave through the nearest exit; they block one another (in C).\n\n"
                   "FREVO's EmergencyExit, as the simulator emergency-exit, of which the data sheet is.",
    .settings = settings, .settings_count = SETTINGS,
    .metrics = METRICS, .sensors = SENSORS, .actuators = ACTUATORS,
    .inputs = 10, .outputs = 2,
    .setup = setup, .reset = reset, .turn = turn, .observe = observe, .act = act, .judge = judge,
};

int main(void) { return zswarm_serve(&emergency_exit); }
