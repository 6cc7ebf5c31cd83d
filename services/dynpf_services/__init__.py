"""The processes, one folder each, and the scenarios that say which of them run and how."""
