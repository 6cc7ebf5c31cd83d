"""The sensors of robots in rooms: simulated from the true state, or played from a log."""
