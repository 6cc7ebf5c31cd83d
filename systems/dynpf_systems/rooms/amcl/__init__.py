"""Parameters of AMCL, of ROS 1 and Nav2, and the scenario that filters as they say."""
