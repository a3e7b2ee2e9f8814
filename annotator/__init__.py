"""The annotation GUI over a headless session."""

from std_toolkit.renamed import install

install()
