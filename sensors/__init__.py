"""Cameras, recordings and simulated sensors."""
