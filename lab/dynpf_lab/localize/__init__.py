"""From a robot's log to a verdict: what it holds, where the robot may start, how well it was localized."""
