"""NLSPN: depth that spreads along learned neighbours, which need not be next to a pixel."""
