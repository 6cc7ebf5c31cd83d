"""The estimator: where the robot is, and the things around it, from what the sensors say."""
