#include "robot.h"

#include "interface.h"

static const double evolved_targets[2 * ROBOT_TARGETS] = {@{places}};

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

int robot_selftest(void)
{
    return @{name}_selftest();
}

int robot_step(robot *self, const float *ranges, int64_t readings, double angle_min, double angle_increment, double x, double y,
               double z, double w, robot_decision *decision)
{
    float scan[ROBOT_RAYS];
    float observation[@{prefix}_INPUTS];
    float action[@{prefix}_OUTPUTS];
    if (!interface_covers(readings, angle_min, angle_increment, ROBOT_VIEW)) {
        return 1;
    }
    interface_fit_scan(ranges, readings, angle_min, angle_increment, ROBOT_RAYS, ROBOT_VIEW, @{reach}, scan);
    decision->distance = interface_observe(scan, ROBOT_RAYS, @{reach}, @{sectors}, x, y, z, w, self->targets, ROBOT_TARGETS, observation);
    @{name}_step(&self->network, observation, action);
    decision->linear = interface_limited(interface_velocity(action[0], @{evolved_speed}), self->speed);
    decision->angular = interface_limited(interface_velocity(action[1], @{evolved_turn}), self->turn);
    return 0;
}
