"""Exporters: recordings of ours in the formats of others."""
