"""Depth restorers: one plug-in each."""
