"""Data sets, methods, metrics and reports of the benchmark."""

from std_toolkit.plugins import install

install()
