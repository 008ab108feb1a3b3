"""Programs between a link and ROS, each a child process: by rospy, by rclpy, by Zenoh."""
