"""The `std-curate` command: parses options, runs a step, prints the result."""
