"""The bridge to a live ROS 2 robot, whose router speaks rmw_zenoh."""
