"""Figures that papers print, to stand beside measured ones."""
