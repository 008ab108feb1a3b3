#!/usr/bin/python3
"""Robots leave a room: a ROS node that plays one trial of a controller, and writes their logs.

A robot senses its nearest exit, and which of the eight places around it, a step away, are free; it
moves by at most a step in x and y, unless a wall or a robot is there. It is out when it is nearer
than epsilon to an exit.
"""

import sys
from pathlib import Path

import controllers
import rospy
from room import Room


def main():
    """Play the trial."""
    rospy.init_node("exit_world")
    parameters = rospy.get_param("~")
    room = Room(parameters)
    robots = range(parameters["numAgents"])
    brains = [controllers.load(parameters) for _ in robots]
    folder = Path(parameters["log_path"])
    folder.mkdir(exist_ok=True)
    logs = [(folder / f"robot_{robot:03}.log").open("w") for robot in robots]
    for log in logs:
        log.write("# step\tdistance to the nearest exit [m]\n")
    for step in range(parameters["steps"]):
        for robot in robots:
            if room.inside[robot]:
                east, north = brains[robot].act(room.observe(robot))
                room.move(robot, 2.0 * float(east) - 1.0, 2.0 * float(north) - 1.0)
                logs[robot].write(f"{step}\t{room.nearest(robot)[0]!r}\n")
        if not any(room.inside):
            break
    for log in logs:
        log.close()


if __name__ == "__main__":
    sys.exit(main())
