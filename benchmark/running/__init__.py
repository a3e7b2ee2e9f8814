"""Scoring of methods over splits: batches, resume, tables, manifests, speed."""
