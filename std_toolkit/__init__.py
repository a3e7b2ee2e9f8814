"""Curation of real RGB-D recordings of specular, transparent and diffuse objects."""

__version__ = "0.1.0"
