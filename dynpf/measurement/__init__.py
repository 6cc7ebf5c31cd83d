"""Measurement models: what a sensor at a given pose would read, and how likely a reading is."""
