"""The experiments of LANDMARK, INDOOR and TURTLEBOT, and those on logs of real robots."""
