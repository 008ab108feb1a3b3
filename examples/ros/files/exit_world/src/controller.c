/* The evolved controller as a library for scripts/controllers.py. zswarm writes candidate.h for each candidate. */

#include <stddef.h>

#include "candidate.h"

size_t controller_size(void);
void controller_reset(void *state);
void controller_step(void *state, const float *observation, float *action);

size_t controller_size(void) { return sizeof(zs_candidate_state); }

void controller_reset(void *state) { zs_candidate_reset(state); }

void controller_step(void *state, const float *observation, float *action) { zs_candidate_step(state, observation, action); }
