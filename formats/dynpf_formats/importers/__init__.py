"""Importers: foreign logs as recordings of ours."""
