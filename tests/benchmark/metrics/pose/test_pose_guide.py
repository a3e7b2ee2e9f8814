"""What the guide to pose metrics says is so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pose_cases import oracle

from benchmark.metrics.pose import BoxIoU, PoseScoring, get_pose_protocol, pose_protocols

GUIDE = (Path(__file__).resolve().parents[4] / "docs" / "pose_metrics.md").read_text()


def rows(first: str) -> list[list[str]]:
    """Cells of the table whose head begins with `first`."""
    lines = GUIDE[GUIDE.index(f"| {first}") :].splitlines()
    table = lines[2 : next(i for i, line in enumerate(lines) if not line.startswith("|"))]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


def test_protocols() -> None:
    words = {
        BoxIoU.ORIENTED: "oriented",
        BoxIoU.AABB: "along the camera's axes",
        BoxIoU.NOCS2019: "along the wrong axis",
        PoseScoring.AP: "average precision",
        PoseScoring.ACCURACY: "matched / predicted",
    }
    table = rows("protocol")
    names = [row[0].split("`")[1] for row in table]
    assert names == ["strict", "paper", "nocs2019"]
    assert set(names) == set(pose_protocols.names())
    for name, (_, iou, score, counted, can, mug) in zip(names, table, strict=True):
        protocol = get_pose_protocol(name)
        assert (words[protocol.iou], words[protocol.score]) == (iou, score)
        assert (protocol.pose_needs_iou is None) == (counted == "all")
        assert ("can" in protocol.classes.upside_down) == (can == "right")
        assert ("mug" in protocol.classes.round_without_handle) == (mug == "round")
        for column in protocol.columns:
            assert f"`{column}`" in GUIDE


@pytest.mark.parametrize("definition", list(BoxIoU))
def test_overlaps_of_the_known_pairs(definition: BoxIoU) -> None:
    found = np.array([p[definition.value] for p in oracle()["box_pairs"]])
    row = next(r for r in rows("150 pairs") if r[0] == f"`{definition.value}`")
    assert row[1:] == [f"{found.mean():.3f}", f"{100 * (found > 0.75).mean():.0f} %"]
