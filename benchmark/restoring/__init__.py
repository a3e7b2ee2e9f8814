"""Depth of a recording restored: `std-restore` and `benchmark.Restorer`."""
