<<<<<<< HEAD
"""The controller: what the robot shall do next, from the estimate alone."""
=======
"""The controller: what the robot shall do next, from the estimated state alone."""
>>>>>>> parts
