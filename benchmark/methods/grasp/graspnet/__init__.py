"""A network of GraspNet's kind: seeds, approach views, cylinders, in-plane angles and depths."""
