"""Shipped weights, each with its SHA-256 and its model card."""
