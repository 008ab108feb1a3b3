/* A robot that @{name} drives: messages in, velocities out. C99; nothing is allocated, printed or global. */
#ifndef ROBOT_H
#define ROBOT_H

#include <stdint.h>

#include "@{name}.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ROBOT_NAME "@{name}"
#define ROBOT_SHA256 @{prefix}_SHA256
#define ROBOT_STEP_S @{step_s}       /* s; it decides once in each */
#define ROBOT_SPEED @{speed}         /* m/s at most, of what it was evolved with and of the robot */
#define ROBOT_TURN @{turn}           /* rad/s at most, likewise */
#define ROBOT_VIEW @{view}           /* radians that its scanner must cover, half of them to each side */
#define ROBOT_DEGREES "@{degrees}"    /* the same, in words */
#define ROBOT_RAYS @{rays}
#define ROBOT_TARGETS @{targets}     /* places that it may go to */
#define ROBOT_ARRIVED @{arrived}     /* m from one of them at which it is there */
#define ROBOT_WATCHDOG_S @{watchdog_s} /* s without messages after which it must stop */

typedef struct {
    @{name}_state network;
    double targets[2 * ROBOT_TARGETS]; /* m: x, y; may be changed after robot_reset */
    double speed, turn;                /* m/s, rad/s; may be lowered */
} robot;

typedef struct {
    double linear;   /* m/s ahead */
    double angular;  /* rad/s counter-clockwise */
    double distance; /* m to the nearest target */
} robot_decision;

/* The robot as it was evolved: limits, targets, and a controller that remembers nothing. */
void robot_init(robot *self);

/* The controller forgets all of before, as at the start of a trial. */
void robot_forget(robot *self);

/* 0 when this machine computes the same bits as the one that evolved the controller. */
int robot_selftest(void);

/* One decision. Ranges in m, angles in radians from the robot's front, counter-clockwise; x, y in m; z, w of the quaternion of the
   robot's heading. Gives 0, or 1 when the scanner does not cover ROBOT_VIEW: then it decides nothing. */
int robot_step(robot *self, const float *ranges, int64_t readings, double angle_min, double angle_increment, double x, double y,
               double z, double w, robot_decision *decision);

#ifdef __cplusplus
}
#endif

#endif
