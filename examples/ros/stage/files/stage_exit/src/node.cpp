// Drive one robot out of the room: scan and pose in, the controller's decision out, as velocity.
//
// It observes what turtlebot-exit of zswarm does (docs/simulators.md): how near something is in
// each eighth of the scan, from the right to the left, and the direction of the nearest exit.

#include <geometry_msgs/Twist.h>
#include <nav_msgs/Odometry.h>
#include <ros/ros.h>
#include <sensor_msgs/LaserScan.h>

#include <algorithm>
#include <cmath>
#include <iostream>

extern "C" {
int controller_selftest(void);
void controller_reset(void);
void controller_step(const float observation[10], float action[2]);
}

namespace {

const int SECTORS = 8;
const double EXITS[][2] = {{-2, 1}, {2, 1}};
const double SPEED = 0.65, TURN = 3.14;  // m/s, rad/s
const double WAKING_S = 0.1;

class Robot {
  public:
    Robot() : epsilon(ros::NodeHandle("~").param("epsilon", 0.6)) {
        controller_reset();
        velocity = node.advertise<geometry_msgs::Twist>("cmd_vel", 10);
        scans = node.subscribe("base_scan", 100, &Robot::scanned, this);
        poses = node.subscribe("base_pose_ground_truth", 100, &Robot::posed, this);
        // Stage may have published before all of this node was there, and wait for it now.
        waking = node.createWallTimer(ros::WallDuration(WAKING_S), &Robot::wake, this);
    }

  private:
    void scanned(const sensor_msgs::LaserScan::ConstPtr &message) {
        scan = message;
        decide();
    }

    void posed(const nav_msgs::Odometry::ConstPtr &message) {
        pose = message;
        decide();
    }

    void wake(const ros::WallTimerEvent &) {
        if (!has_decided)
            velocity.publish(geometry_msgs::Twist());
    }

    // Decide once for each stamp, when both messages of it are there.
    void decide() {
        if (!scan || !pose || scan->header.stamp != pose->header.stamp)
            return;
        has_decided = true;
        float observation[SECTORS + 2], action[2];
        is_out = observe(observation) < epsilon || is_out;
        geometry_msgs::Twist command;
        if (!is_out) {
            controller_step(observation, action);
            command.linear.x = SPEED * (2.0 * clip(action[0]) - 1.0);
            command.angular.z = TURN * (2.0 * clip(action[1]) - 1.0);
        }
        velocity.publish(command);
    }

    static double clip(float value) { return std::min(std::max(double(value), 0.0), 1.0); }

    // Fill the observation; return the distance to the nearest exit, m.
    double observe(float *observation) const {
        const size_t rays = scan->ranges.size();
        std::fill(observation, observation + SECTORS, 0.0f);
        for (size_t ray = 0; ray < rays; ++ray) {
            float &near = observation[ray * SECTORS / rays];
            near = std::max(near, 1.0f - std::min(scan->ranges[ray] / scan->range_max, 1.0f));
        }
        const auto &at = pose->pose.pose;
        double nearest = HUGE_VAL, x = 0, y = 0;
        for (const auto &exit : EXITS) {
            const double dx = exit[0] - at.position.x, dy = exit[1] - at.position.y;
            if (std::hypot(dx, dy) < nearest) {
                nearest = std::hypot(dx, dy);
                x = dx / nearest;
                y = dy / nearest;
            }
        }
        const double heading = 2 * std::atan2(at.orientation.z, at.orientation.w);
        const double c = std::cos(heading), s = std::sin(heading);
        observation[SECTORS] = float(c * x + s * y);
        observation[SECTORS + 1] = float(c * y - s * x);
        return nearest;
    }

    ros::NodeHandle node;
    const double epsilon;
    ros::Publisher velocity;
    ros::Subscriber scans, poses;
    ros::WallTimer waking;
    sensor_msgs::LaserScan::ConstPtr scan;
    nav_msgs::Odometry::ConstPtr pose;
    bool is_out = false, has_decided = false;
};

}  // namespace

int main(int count, char **words) {
    if (controller_selftest() != 0) {
        std::cerr << "the candidate's self-test fails: this machine or compiler computes other numbers" << std::endl;
        return 1;
    }
    ros::init(count, words, "robot");
    while (ros::ok() && !ros::param::has("/referee/ready"))
        ros::WallDuration(WAKING_S).sleep();
    Robot robot;
    ros::spin();
}
