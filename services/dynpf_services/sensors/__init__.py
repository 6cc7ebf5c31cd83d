"""The sensor publisher: readings drawn from the true state, or taken from an imported log."""
