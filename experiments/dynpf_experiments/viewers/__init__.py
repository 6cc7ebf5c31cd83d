"""Runs as other people's viewers read them: Foxglove, Lichtblick and Rerun."""
