"""Camera poses of the simulator: random viewpoints of a scene, and smooth paths around it."""
