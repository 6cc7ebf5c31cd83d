"""Localization in a map by filters composed of motion and measurement models."""
