"""Simulations over ROS."""
