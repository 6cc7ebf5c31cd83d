"""The controller: what the robot shall do next, from the estimate alone."""
