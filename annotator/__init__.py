"""The annotation GUI over a headless session."""

from std_toolkit.plugins import install

install()
