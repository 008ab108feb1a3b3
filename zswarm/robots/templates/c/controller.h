/*
@{about}
 */
#ifndef @{macro}_H
#define @{macro}_H

#ifdef __cplusplus
extern "C" {
#endif

#define @{macro}_INPUTS @{inputs}
#define @{macro}_OUTPUTS @{outputs}
#define @{macro}_STATE @{state} /* numbers in one robot's memory */
#define @{macro}_SHA256 "@{sha256}" /* of the parameters, float32, little-endian */
#define @{macro}_GENERATOR "zswarm @{version}"
@{names}
/* The memory of one robot's controller. Each robot has its own, and starts with @{unit}_reset. */
typedef struct {
    float x[@{macro}_STATE];
} @{unit}_state;

/* Clear the memory, as at the start of a trial. */
void @{unit}_reset(@{unit}_state *state);

/* Decide: read observation, and write action; both in the order above. */
void @{unit}_step(@{unit}_state *state, const float observation[@{macro}_INPUTS], float action[@{macro}_OUTPUTS]);

/* Compare @{steps} steps with stored decisions and states: 0 when all have the same bits here,
 * otherwise the number of the first step that differs, from 1. With @{macro}_NO_SELFTEST it is
 * not compiled; with @{macro}_MAIN the source is a program that returns its result. */
int @{unit}_selftest(void);

#ifdef __cplusplus
}
#endif

#endif
