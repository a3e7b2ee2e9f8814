"""Many scenes: what is done in each, and what is next."""
