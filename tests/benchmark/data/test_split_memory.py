"""Going through 30,000 frames takes no more memory than going through some."""

from __future__ import annotations

import pickle
import tracemalloc
from pathlib import Path

import pytest
from dreds_on_disk import write_std_scene

from benchmark.data.splits import open_split

SCENES, FRAMES = 30, 1000


@pytest.mark.slow
def test_memory_is_flat(tmp_path: Path) -> None:
    """30 scenes of 1000 frames, all of them links to one; a share of them is read."""
    first = tmp_path / "STD-CatKnown/scene_0"
    write_std_scene(first, frames=1, label_size=(64, 36))
    files = list(first.iterdir())
    for i in range(1, FRAMES):
        for path in files:
            (first / f"{i:04d}{path.name[4:]}").symlink_to(path.name)
    for k in range(1, SCENES):
        (tmp_path / f"STD-CatKnown/scene_{k}").symlink_to(first.name)

    tracemalloc.start()
    try:
        source = open_split("std-catknown", tmp_path)
        assert len(source) == SCENES * FRAMES
        listed, peak = tracemalloc.get_traced_memory()
        # The names of the frames of all scenes are the same few strings.
        assert listed < 6e6
        assert len(pickle.dumps(source)) < 1e6
        frame_bytes = 128 * 72 * (3 + 4) + 64 * 36 * 5
        for index in range(0, SCENES * FRAMES, 500):
            source.load(index)
            if index == 5000:
                early = tracemalloc.get_traced_memory()[0]
        late, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert late - early < frame_bytes
    assert peak < 3e7
