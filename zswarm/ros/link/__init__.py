"""Links to a ROS graph."""
