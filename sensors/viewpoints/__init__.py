"""Where the simulator's cameras stand: random viewpoints of a scene, and smooth ways around it."""
