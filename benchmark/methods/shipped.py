"""Where the weights that come with the toolkit are, and which preset they stand for."""

from __future__ import annotations

from pathlib import Path

PUBLISHED, COMPACT = "published", "compact"
SHIPPED = Path(__file__).resolve().parent.parent / "weights"


def shipped_file(method: str, preset: str) -> Path:
    """Where weights that come with the toolkit would be."""
    return SHIPPED / f"{method}-{preset}.safetensors"


def preset_for(method: str, asked: str | None, weights: Path | None) -> str:
    """The preset that a network is made with.

    Args:
        method: its name.
        asked: what a user wants; None is `published`, but `compact` where no weights are given
            and the toolkit brings some of that size.
        weights: a user's own.
    """
    if asked is not None:
        return asked
    if weights is None and shipped_file(method, COMPACT).is_file():
        return COMPACT
    return PUBLISHED
