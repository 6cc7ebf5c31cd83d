"""The laboratory: studies, measures, references, benchmarks and the command line."""
