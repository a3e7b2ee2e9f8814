"""Weights that come with the toolkit, each with its SHA-256 and its model card."""
