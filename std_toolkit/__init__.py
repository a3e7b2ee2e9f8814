"""Curation of real RGB-D recordings of specular, transparent and diffuse objects."""

from std_toolkit.renamed import install

__version__ = "0.1.0"

install()
