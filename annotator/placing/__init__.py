"""Where a mesh comes to lie when it is added: its unit, its name, its first pose."""
