"""A run that goes on, in browsers on this machine: the page of a run while it runs, and a person's acts on it."""
