// When a robot decides and when it stops: messages and the time in, velocities out. Without ROS.
#ifndef DRIVING_HPP
#define DRIVING_HPP

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "robot.h"

struct Scan {
  std::uint64_t stamp_ns;
  std::vector<float> ranges;  // m
  double angle_min, angle_increment;  // radians from the robot's front, counter-clockwise
};

struct Pose {
  std::uint64_t stamp_ns;
  double x, y;  // m
  double z, w;  // of the quaternion of its heading
};

struct Velocity {
  double linear = 0.0;   // m/s ahead
  double angular = 0.0;  // rad/s counter-clockwise
};

// A robot decides each ROBOT_STEP_S by the newest scan and pose (on_step). In lock-step, for
// simulations that wait for each decision, it decides whenever scan and pose of one stamp have come,
// and the simulation decides when it stops. If a function returns true, send `velocity`. Times are
// seconds of a monotonic clock.
class Driving {
 public:
  Driving(robot *robot, double watchdog_s, bool lock_step)
      : robot_(robot), watchdog_s_(watchdog_s), lock_step_(lock_step) {
    forget();
  }

  Velocity velocity;
  bool arrived = false;  // it stopped at a target
  bool silent = false;   // its sensors are silent

  bool on_scan(double now_s, const Scan &scan) {
    if (has_scan_ && scan.stamp_ns < scan_.stamp_ns) forget();  // a simulation restarted
    if (!has_scan_ || scan.stamp_ns != scan_.stamp_ns) {        // a driver that hangs repeats its last
      scan_ = scan;
      has_scan_ = true;
      scan_s_ = now_s;
    }
    return together(now_s);
  }

  bool on_pose(double now_s, const Pose &pose) {
    if (has_pose_ && pose.stamp_ns < pose_.stamp_ns) forget();
    if (!has_pose_ || pose.stamp_ns != pose_.stamp_ns) {
      pose_ = pose;
      has_pose_ = true;
      pose_s_ = now_s;
    }
    return together(now_s);
  }

  // Another ROBOT_STEP_S passed.
  bool on_step(double now_s) {
    if (lock_step_ || !has_scan_ || !has_pose_) return false;
    silent = now_s - std::min(scan_s_, pose_s_) > watchdog_s_;
    if (!arrived && !silent) return decide(now_s);
    decided_ = true;
    decided_s_ = now_s;
    velocity = Velocity();
    return true;
  }

  // Check the watchdog: true if the robot must stop now.
  bool on_watch(double now_s) {
    if (lock_step_ || !decided_) return false;
    const bool both = has_scan_ && has_pose_;  // after a restart one may not come
    silent = now_s - (both ? std::min(scan_s_, pose_s_) : decided_s_) > watchdog_s_;
    if (!silent && now_s - decided_s_ <= watchdog_s_) return false;
    velocity = Velocity();
    return true;
  }

 private:
  robot *robot_;
  const double watchdog_s_;
  const bool lock_step_;
  Scan scan_{};
  Pose pose_{};
  bool has_scan_ = false, has_pose_ = false, decided_ = false, decided_together_ = false;
  double scan_s_ = 0.0, pose_s_ = 0.0, decided_s_ = 0.0;
  std::uint64_t last_ns_ = 0;

  bool together(double now_s) {
    if (!lock_step_ || !has_scan_ || !has_pose_ || scan_.stamp_ns != pose_.stamp_ns) return false;
    if (decided_together_ && scan_.stamp_ns == last_ns_) return false;
    decided_together_ = true;
    last_ns_ = scan_.stamp_ns;
    return decide(now_s);
  }

  bool decide(double now_s) {
    robot_decision decision;
    if (robot_step(robot_, scan_.ranges.data(), static_cast<std::int64_t>(scan_.ranges.size()), scan_.angle_min,
                   scan_.angle_increment, pose_.x, pose_.y, pose_.z, pose_.w, &decision) != 0) {
      throw std::runtime_error("the scanner does not cover the " ROBOT_DEGREES " degrees that the controller needs");
    }
    decided_ = true;
    decided_s_ = now_s;
    velocity = Velocity();
    if (!lock_step_ && decision.distance < ROBOT_ARRIVED) {
      arrived = true;
    } else {
      velocity.linear = decision.linear;
      velocity.angular = decision.angular;
    }
    return true;
  }

  void forget() {
    robot_forget(robot_);
    has_scan_ = has_pose_ = decided_together_ = arrived = silent = false;
  }
};

#endif
