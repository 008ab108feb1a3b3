#include "robot.h"

#include <string.h>

#include "interface.h"

static const double evolved_targets[2 * ROBOT_TARGETS] = {@{places}};

/* Steps of the self-test: scans and poses, and what is observed; actions, and decisions. */
#define CHECKS @{check_steps}
static const float check_ranges[CHECKS][ROBOT_RAYS] = {
@{check_ranges}
};
static const double check_poses[CHECKS][4] = {
@{check_poses}
};
static const float check_observations[CHECKS][@{prefix}_INPUTS] = {
@{check_observations}
};
static const float check_actions[CHECKS][@{prefix}_OUTPUTS] = {
@{check_actions}
};
static const double check_decisions[CHECKS][3] = {
@{check_decisions}
};

static int same(double left, double right)
{
    return memcmp(&left, &right, sizeof left) == 0;
}

void robot_init(robot *self)
{
    int k;
    for (k = 0; k < 2 * ROBOT_TARGETS; k++) {
        self->targets[k] = evolved_targets[k];
    }
    self->speed = ROBOT_SPEED;
    self->turn = ROBOT_TURN;
    robot_forget(self);
}

void robot_forget(robot *self)
{
    @{name}_reset(&self->network);
}

/* Observe; return the distance to the nearest target. */
static double observe(const robot *self, const float *ranges, int64_t readings, double angle_min, double angle_increment,
                      const double pose[4], float observation[@{prefix}_INPUTS])
{
    float scan[ROBOT_RAYS];
    interface_fit_scan(ranges, readings, angle_min, angle_increment, ROBOT_RAYS, ROBOT_VIEW, @{reach}, scan);
    return interface_observe(scan, ROBOT_RAYS, @{reach}, @{sectors}, pose[0], pose[1], pose[2], pose[3], self->targets,
                             ROBOT_TARGETS, observation);
}

/* Turn an action into velocities. */
static void drive(const robot *self, const float action[@{prefix}_OUTPUTS], robot_decision *decision)
{
    decision->linear = interface_limited(interface_velocity(action[0], @{evolved_speed}), self->speed);
    decision->angular = interface_limited(interface_velocity(action[1], @{evolved_turn}), self->turn);
}

int robot_selftest(void)
{
    robot self;
    robot_decision decision;
    int differs = @{name}_selftest();
    robot_init(&self);
    for (int step = 0; (step < CHECKS) && (differs == 0); step++) {
        const double *expected = check_decisions[step];
        float observation[@{prefix}_INPUTS];
        decision.distance = observe(&self, check_ranges[step], ROBOT_RAYS, @{first}, @{between}, check_poses[step], observation);
        drive(&self, check_actions[step], &decision);
        if ((memcmp(observation, check_observations[step], sizeof observation) != 0) || !same(decision.linear, expected[0]) ||
            !same(decision.angular, expected[1]) || !same(decision.distance, expected[2])) {
            differs = step + 1;
        }
    }
    return differs;
}

int robot_step(robot *self, const float *ranges, int64_t readings, double angle_min, double angle_increment, double x, double y,
               double z, double w, robot_decision *decision)
{
    const double pose[4] = {x, y, z, w};
    float observation[@{prefix}_INPUTS];
    float action[@{prefix}_OUTPUTS];
    if (!interface_covers(readings, angle_min, angle_increment, ROBOT_VIEW)) {
        return 1;
    }
    decision->distance = observe(self, ranges, readings, angle_min, angle_increment, pose, observation);
    @{name}_step(&self->network, observation, action);
    drive(self, action, decision);
    return 0;
}
