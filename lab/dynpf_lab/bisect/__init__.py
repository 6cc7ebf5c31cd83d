"""Which commit made the replay of a recording differ: git bisects, in a worktree."""
