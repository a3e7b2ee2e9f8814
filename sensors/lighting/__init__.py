"""Light of the simulator: environment maps from a folder or procedural, strengths, floors."""
