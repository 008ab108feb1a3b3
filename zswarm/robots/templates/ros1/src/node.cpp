// Drives one robot with @{name}: a laser scan and odometry in, a velocity out.
//
// Private parameters: targets (x, y of each, m, in the frame of the odometry), speed and turn (m/s
// and rad/s; they lower the limits), lock_step (for simulations that wait for each decision).
#include <csignal>
#include <cmath>

#include <geometry_msgs/@{twist}.h>
#include <nav_msgs/Odometry.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <sensor_msgs/LaserScan.h>

#include "driving.hpp"

namespace {

volatile std::sig_atomic_t ending = 0;

void end(int) { ending = 1; }

double now_s() { return ros::SteadyTime::now().toSec(); }

class Node {
 public:
  Node(ros::NodeHandle &here, robot *self, bool lock_step)
      : driving_(self, ROBOT_WATCHDOG_S, lock_step),
        publisher_(here.advertise<geometry_msgs::@{twist}>("@{velocity_topic}", 1)),
        scans_(here.subscribe("@{scan_topic}", 1, &Node::on_scan, this, ros::TransportHints().tcpNoDelay())),
        poses_(here.subscribe("@{odometry_topic}", 1, &Node::on_pose, this, ros::TransportHints().tcpNoDelay())) {
    if (!lock_step) {
      step_ = here.createTimer(ros::Duration(ROBOT_STEP_S), &Node::on_step, this);
      watch_ = here.createSteadyTimer(ros::WallDuration(ROBOT_WATCHDOG_S / 4.0), &Node::on_watch, this);
    }
  }

  void send(const Velocity &velocity) {
    geometry_msgs::@{twist} message;
@{fill}
    publisher_.publish(message);
  }

 private:
  Driving driving_;
  ros::Publisher publisher_;
  ros::Subscriber scans_, poses_;
  ros::Timer step_;
  ros::SteadyTimer watch_;
  bool logged_silent_ = false, logged_arrived_ = false;

  void on_scan(const sensor_msgs::LaserScan::ConstPtr &scan) {
    if (driving_.on_scan(now_s(), {scan->header.stamp.toNSec(), scan->ranges, scan->angle_min, scan->angle_increment})) {
      send(driving_.velocity);
    }
  }

  void on_pose(const nav_msgs::Odometry::ConstPtr &odometry) {
    const geometry_msgs::Pose &pose = odometry->pose.pose;
    if (driving_.on_pose(now_s(), {odometry->header.stamp.toNSec(), pose.position.x, pose.position.y, pose.orientation.z,
                                   pose.orientation.w})) {
      send(driving_.velocity);
    }
  }

  void on_step(const ros::TimerEvent &) {
    if (driving_.on_step(now_s())) send(driving_.velocity);
    log_news();
  }

  void on_watch(const ros::SteadyTimerEvent &) {
    if (driving_.on_watch(now_s())) send(driving_.velocity);
    log_news();
  }

  void log_news() {
    if (driving_.silent && !logged_silent_) ROS_WARN("stopped: no new scan or odometry for %g s", ROBOT_WATCHDOG_S);
    if (!driving_.silent && logged_silent_) ROS_INFO("scans and odometry come again: driving");
    if (driving_.arrived && !logged_arrived_) ROS_INFO("stopped: nearer than %g m to a target", ROBOT_ARRIVED);
    logged_silent_ = driving_.silent;
    logged_arrived_ = driving_.arrived;
  }
};

// A limit that a parameter lowers.
double lowered(const ros::NodeHandle &mine, const char *name, double most) {
  const double value = mine.param(name, most);
  if (!(value >= 0.0 && value <= most)) {
    throw std::runtime_error(std::string(name) + ": expected 0 to " + std::to_string(most) + ", not " + std::to_string(value));
  }
  return value;
}

void configure(const ros::NodeHandle &mine, robot *self) {
  if (robot_selftest() != 0) {
    throw std::runtime_error("the self-test of " ROBOT_NAME " fails: this machine computes other numbers than those evolved");
  }
  robot_init(self);
  self->speed = lowered(mine, "speed", ROBOT_SPEED);
  self->turn = lowered(mine, "turn", ROBOT_TURN);
  const std::vector<double> targets =
      mine.param("targets", std::vector<double>(self->targets, self->targets + 2 * ROBOT_TARGETS));
  const bool finite = std::all_of(targets.begin(), targets.end(), [](double x) { return std::isfinite(x); });
  if (targets.size() != 2 * ROBOT_TARGETS || !finite) {
    throw std::runtime_error("targets: expected " + std::to_string(2 * ROBOT_TARGETS) + " numbers: x, y of each target in m");
  }
  std::copy(targets.begin(), targets.end(), self->targets);
  if (mine.param("lock_step", false) && !ros::Time::isSimTime()) {
    throw std::runtime_error("lock_step: for simulations; expected /use_sim_time to be true");
  }
}

// Drive until a signal or an error; return the program's exit code.
int drive() {
  try {
    while (!ending && ros::ok()) {
      ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.1));
    }
  } catch (const std::exception &error) {
    ROS_FATAL("%s", error.what());
    return 1;
  }
  return 0;
}

}  // namespace

int main(int argc, char **argv) {
  ros::init(argc, argv, "drive", ros::init_options::NoSigintHandler);
  ros::NodeHandle here, mine("~");
  std::signal(SIGINT, end);
  std::signal(SIGTERM, end);
  try {
    robot self;
    configure(mine, &self);
    const bool lock_step = mine.param("lock_step", false);
    Node node(here, &self, lock_step);
    ROS_INFO("%s drives: at most %g m/s and %g rad/s, parameters %.12s", ROBOT_NAME, self.speed, self.turn, ROBOT_SHA256);
    const int code = drive();
    if (!lock_step) {
      node.send(Velocity());  // stop the robot
      ros::WallDuration(0.2).sleep();
    }
    return code;
  } catch (const std::exception &error) {
    ROS_FATAL("%s", error.what());
    return 1;
  }
}
