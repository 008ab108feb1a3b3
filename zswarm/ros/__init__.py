"""ROS: simulations as simulators, and their topics through one of three links (docs/ros.md)."""
