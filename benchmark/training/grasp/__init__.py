"""Scenes of labelled grasps: made, packed, and trained on."""
