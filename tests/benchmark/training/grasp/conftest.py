"""Nothing here runs without torch, which only the extra `train` brings."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

collect_ignore_glob = [] if find_spec("torch") else ["test_*.py"]


@pytest.fixture(scope="session")
def grasp_pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A packed scene of three objects, seen twice."""
    from tests.benchmark.training.grasp.grasp_scene import pack_scene

    return pack_scene(tmp_path_factory.mktemp("grasps") / "pack")
