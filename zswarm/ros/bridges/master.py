"""A ROS master of its own, on a free port, until the parent closes the pipe. Run by the Python that has rospy."""

from __future__ import annotations

import frames


def main() -> None:
    """Say the master's address, and wait."""
    pipe = frames.Pipe()
    try:
        from rosmaster.master import Master
    except ImportError:
        frames.refuse(
            "rosmaster is not there: install it (Debian: apt install ros-core), or name its Python in ZSWARM_ROS1_PYTHON"
        )
    pipe.set_up()
    master = Master(port=0)
    master.start()
    pipe.say(frames.frame(frames.CONTROL, master.uri.encode()))
    pipe.publish({}, [])
    master.stop()


if __name__ == "__main__":
    main()
