"""Where a mesh comes to lie when it is added: its unit, its first pose, which way up it stands."""
