"""Localization in a map: filters put together from motion and measurement models."""
