"""Training of restorers that are networks: `std-train`."""
