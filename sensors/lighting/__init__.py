"""Light of the simulator: environment maps from a folder or made here, strengths, floors."""
