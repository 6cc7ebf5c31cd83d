"""Figures of a run for papers, reports and notebooks. They need matplotlib, which the extra ``figures`` installs."""
