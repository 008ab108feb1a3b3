/* The evolved controller, for node.cpp. zswarm writes candidate.h for each candidate. */

#include "candidate.h"

static zs_candidate_state state;

int controller_selftest(void);
void controller_reset(void);
void controller_step(const float observation[10], float action[2]);

/* Return 0 if this candidate has its own bits here: it comes with the numbers to compare. */
int controller_selftest(void) { return zs_candidate_selftest(); }

void controller_reset(void) { zs_candidate_reset(&state); }

void controller_step(const float observation[10], float action[2]) { zs_candidate_step(&state, observation, action); }
