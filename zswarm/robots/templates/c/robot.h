/* A robot driven by @{name}: messages in, velocities out. C99; nothing is allocated or printed. */
#ifndef ROBOT_H
#define ROBOT_H

#include <stdint.h>

#include "@{name}.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ROBOT_NAME "@{name}"
#define ROBOT_SHA256 @{prefix}_SHA256
#define ROBOT_STEP_S @{step_s}       /* s between decisions */
#define ROBOT_SPEED @{speed}         /* m/s at most: as evolved, and as the robot can */
#define ROBOT_TURN @{turn}           /* rad/s at most, likewise */
#define ROBOT_VIEW @{view}           /* radians that its scanner must cover, half to each side */
#define ROBOT_DEGREES "@{view_degrees}"    /* the same */
#define ROBOT_RAYS @{rays}
#define ROBOT_TARGETS @{targets}     /* places to go to */
#define ROBOT_ARRIVED @{arrived}     /* m from a target at which it has arrived */
#define ROBOT_WATCHDOG_S @{watchdog_s} /* s without messages until it stops */

typedef struct {
    @{name}_state network;
    double targets[2 * ROBOT_TARGETS]; /* m: x, y; may be changed after robot_init */
    double speed, turn;                /* m/s, rad/s; may be lowered */
} robot;

typedef struct {
    double linear;   /* m/s ahead */
    double angular;  /* rad/s counter-clockwise */
    double distance; /* m to the nearest target */
} robot_decision;

/* Set limits and targets as evolved, and clear the controller's memory. */
void robot_init(robot *self);

/* Clear the controller's memory, as at the start of a trial. */
void robot_forget(robot *self);

/* Return 0 if this machine computes the bits of the one that evolved the controller: first
   @{name}_selftest(), then what the robot observes, and how it drives. So the test is also that of
   another controller with as many inputs and outputs, if that is what @{name}.c and .h are. */
int robot_selftest(void);

/* Decide. Ranges in m, angles in radians from the robot's front, counter-clockwise; x, y in m; z, w
   of the quaternion of its heading. Return 0, or 1 if the scanner does not cover ROBOT_VIEW. */
int robot_step(robot *self, const float *ranges, int64_t readings, double angle_min, double angle_increment, double x, double y,
               double z, double w, robot_decision *decision);

#ifdef __cplusplus
}
#endif

#endif
