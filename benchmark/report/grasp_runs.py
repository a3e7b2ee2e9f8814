"""Which runs of table clearing a report is about: with what, and where."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from benchmark.clearing.results import GraspResult
from std_toolkit.checks.markup import Cell, table, words

_HEADS = ("planner", "depth", "camera", "seed", "tables", "how", "weights", "ran on", "tool")


def grasp_runs(results: Sequence[GraspResult]) -> str:
    """What ran, with what, on what."""
    rows = []
    for result in results:
        m, s = result.manifest, result.manifest.setup
        how = [f"planner {s.planner_preset}"] if s.planner_weights_sha256 else []
        how += [f"depth {s.depth_preset}"] if s.depth_preset else []
        how += [f"{s.planner}.{k}={v}" for k, v in sorted(s.planner_settings.items())]
        how += [f"{s.depth}.{k}={v}" for k, v in sorted(s.depth_settings.items())]
        digests = [w[:12] for w in (s.planner_weights_sha256, s.depth_weights_sha256) if w]
        rows.append(
            [
                Cell(escape(m.planner_label)),
                Cell(escape(m.depth_label)),
                Cell(escape(s.camera)),
                Cell(str(s.seed), numeric=True),
                Cell(str(result.rates.rounds), numeric=True),
                Cell(escape(", ".join(how) or "-")),
                Cell(words(" ".join(f"`{w}`" for w in digests) or "-")),
                Cell(escape(m.hardware.get("gpus") or m.hardware.get("processor", ""))),
                Cell(escape(m.version_of_tool)),
            ]
        )
    return table([(head, "") for head in _HEADS], rows)
