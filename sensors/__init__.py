"""Cameras, recordings and simulated sensors."""

from std_toolkit.renamed import install

install()
