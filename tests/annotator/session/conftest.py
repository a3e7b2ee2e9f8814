"""Small scenes to annotate, with and without camera poses."""

from __future__ import annotations

from pathlib import Path

import pytest
from curated import label_more
from scene_on_disk import write_scene


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Three frames with metric camera poses; one box, labelled and propagated."""
    return write_scene(tmp_path / "scene").root


@pytest.fixture
def loose_root(tmp_path: Path) -> Path:
    """Three frames without camera poses; one box, not labelled."""
    return write_scene(tmp_path / "loose", labelled=False).root


@pytest.fixture
def several(root: Path) -> Path:
    """The scene with three objects: one propagated, one annotated in two frames, one unlabelled."""
    return label_more(root)
