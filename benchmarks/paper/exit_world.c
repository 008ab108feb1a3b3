/* Emergency exit as the simulator of the paper's file-based design: it is compiled with a candidate's controller, reads its parameters
   from parameters.yaml and leaves a log for each agent: its distance to the nearest exit after each step. */

#define main serve_zswarm /* of the example, whose simulator this is */
#include "emergency_exit.c"
#undef main

#include <time.h>

#include "zs_candidate.h"

static double seed, step_s;

static void read_parameters(void) {
    FILE *file = fopen("parameters.yaml", "r");
    char key[64];
    double value;
    if (!file) zswarm__fail("parameters.yaml cannot be read");
    while (fscanf(file, " %63[^:]: %lf", key, &value) == 2) {
        if (!strcmp(key, "trial_seed")) seed = value;
        if (!strcmp(key, "step_s")) step_s = value;
        for (int i = 0; i < SETTINGS; i++)
            if (!strcmp(key, settings[i].name)) settings[i].number = value;
    }
    fclose(file);
}

static double distance(int agent) {
    const double x = here[agent]->exit_x, y = here[agent]->exit_y;
    return sqrt(x * x + y * y);
}

static void end_step(FILE **logs, int step) {
    const struct timespec pause = {(time_t)step_s, (long)((step_s - (double)(time_t)step_s) * 1e9)};
    for (int i = 0; i < agents; i++) fprintf(logs[i], "%d\t%.17g\n", step, distance(i));
    if (step_s > 0) nanosleep(&pause, NULL);
}

int main(void) {
    const char *refusal;
    char name[32];
    float observation[ZS_CANDIDATE_INPUTS], action[ZS_CANDIDATE_OUTPUTS];
    int agent, step = 0;

    read_parameters();
    if ((refusal = setup())) zswarm__fail(refusal);
    zs_candidate_state *states = zswarm__memory(NULL, (size_t)agents * sizeof *states);
    FILE **logs = zswarm__memory(NULL, (size_t)agents * sizeof *logs);
    for (int i = 0; i < agents; i++) {
        zs_candidate_reset(&states[i]);
        snprintf(name, sizeof name, "agent_%d.log", i);
        if (!(logs[i] = fopen(name, "w"))) zswarm__fail("a log cannot be written");
        fprintf(logs[i], "# step\tdistance\n");
    }
    reset((uint64_t)seed);
    while (turn(&agent)) {
        if (round_ != step) {
            end_step(logs, step);
            step = round_;
        }
        observe(agent, observation);
        zs_candidate_step(&states[agent], observation, action);
        act(agent, action);
    }
    end_step(logs, step);
    for (int i = 0; i < agents; i++) fclose(logs[i]);
    return 0;
}
