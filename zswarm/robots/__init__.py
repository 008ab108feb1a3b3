"""Controllers leave for robots: C99, packages for ROS, files that other programs read."""
