"""Joint refinement of object poses against several images."""
