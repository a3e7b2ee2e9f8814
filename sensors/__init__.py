"""Cameras, recordings and simulated sensors."""

from std_toolkit.plugins import install

install()
