"""Data sets, methods, metrics and reports of the benchmark."""
