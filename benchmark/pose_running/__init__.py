"""Pose methods over splits: views, batches, tables of what was there and what was found, scores."""
