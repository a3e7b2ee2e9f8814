"""Restorers without learning, which fill holes from measured pixels."""
