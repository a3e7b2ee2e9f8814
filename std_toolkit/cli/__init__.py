"""The `std-curate` command: parses, calls a step, prints."""
