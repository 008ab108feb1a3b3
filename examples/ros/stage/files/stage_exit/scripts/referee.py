#!/usr/bin/python3
"""Write the logs of the robots, and end when the trial is over, with which roslaunch ends."""

import math
import threading
from pathlib import Path

import rospy
from nav_msgs.msg import Odometry

EXITS = ((-2, 1), (2, 1))
STEP_S = 0.2


class Referee:
    """The logs: for each step of a robot that is inside, its distance to the nearest exit."""

    def __init__(self, folder, robots, steps, epsilon):
        self.steps, self.epsilon = steps, epsilon
        self.inside, self.over = set(range(robots)), threading.Event()
        self.lock, self.first = threading.Lock(), 0.0
        folder.mkdir(exist_ok=True)
        self.logs = [(folder / f"robot_{robot}.log").open("w") for robot in range(robots)]
        for robot in range(robots):
            name = f"/robot_{robot}/base_pose_ground_truth"
            rospy.Subscriber(name, Odometry, self.see, callback_args=robot)

    def see(self, message, robot):
        """Write a line; a robot that is out, or out of time, has no more."""
        position = message.pose.pose.position
        distance = min(math.hypot(x - position.x, y - position.y) for x, y in EXITS)
        seconds = message.header.stamp.to_sec()
        with self.lock:
            self.first = self.first or seconds
            step = round((seconds - self.first) / STEP_S)
            if robot in self.inside:
                self.logs[robot].write(f"{step}\t{distance!r}\n")
                if distance < self.epsilon or step >= self.steps:
                    self.inside.discard(robot)
            if not self.inside:
                self.over.set()


def main():
    """Watch one trial."""
    rospy.init_node("referee", disable_signals=True)
    here = Path(__file__).parent.parent
    given = (rospy.get_param(f"~{name}") for name in ("robots", "steps", "epsilon"))
    referee = Referee(here / "log", *given)
    rospy.set_param("~ready", True)  # the robots wait for it
    referee.over.wait()
    for log in referee.logs:
        log.close()


if __name__ == "__main__":
    main()
