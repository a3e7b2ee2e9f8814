"""Rendering of the simulator: infrared pairs, colour and exact maps of a scene."""
