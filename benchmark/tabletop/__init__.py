"""Table clearing in simulation: objects on a table, a camera, a planner, a gripper with physics."""
