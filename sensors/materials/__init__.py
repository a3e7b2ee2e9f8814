"""Materials of the simulator: a library of ranges, draws from it, and procedural textures."""
