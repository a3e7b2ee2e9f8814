"""Scenes with labelled grasps: generation, packing and training."""
