"""Table clearing in simulation: objects on a table, a camera, a planner, and a hand with physics."""
