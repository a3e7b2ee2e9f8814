"""Augmentation of frames in training: colour, whole frames, depth of objects, holes."""
