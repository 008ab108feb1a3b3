"""A separate ROS master on a free port, until the parent closes the pipe. Its Python has rospy."""

from __future__ import annotations

import frames

NO_MASTER = (
    "rosmaster is missing: install it (Debian: apt install ros-core), or name its Python in "
    "ZSWARM_ROS1_PYTHON"
)


def main() -> None:
    """Report the master's address, and wait."""
    pipe = frames.Pipe()
    rosmaster = frames.need("rosmaster.master", NO_MASTER)
    pipe.set_up()
    master = rosmaster.Master(port=0)
    master.start()
    pipe.write(frames.frame(frames.CONTROL, master.uri.encode()))
    pipe.publish({}, [])
    master.stop()


if __name__ == "__main__":
    main()
