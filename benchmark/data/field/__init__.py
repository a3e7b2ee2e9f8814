"""Readers of the field's data sets, from their published layouts."""
