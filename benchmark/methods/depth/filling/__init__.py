"""Restorers that learn nothing: they fill what the sensor left out from what it measured."""
