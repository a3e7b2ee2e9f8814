"""From a seed to a finished scene: draw, settle, render, match, write; many of them in parallel."""
