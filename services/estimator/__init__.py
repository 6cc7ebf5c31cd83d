"""The estimator process: from what is sensed to where the robot, and the parts, are."""
