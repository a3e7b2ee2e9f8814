"""Data sets of the benchmark, read from their own layouts."""
