"""Exporters: recordings in foreign formats."""
