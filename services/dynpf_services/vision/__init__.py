"""The vision process: finds the discs in the overhead camera's frames and tells where they lie in the workspace."""
