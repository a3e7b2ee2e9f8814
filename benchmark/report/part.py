"""What one task (depth, pose, grasping) adds to a report."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.clearing.manifest import GRASP_MANIFEST
from benchmark.pose_running.bop_results import FILE as BOP_FILE
from benchmark.pose_running.manifest import POSE_MANIFEST
from benchmark.running.manifest import MANIFEST
from std_toolkit.errors import ToolkitError


@dataclass(frozen=True)
class PageSection:
    """A section of the page.

    Attributes:
        anchor: unique on the page.
        title: of its heading and its link.
        html: what it holds; a section without anything is left out.
    """

    anchor: str
    title: str
    html: str


@dataclass(frozen=True, kw_only=True)
class ReportPart:
    """All that one task adds.

    Attributes:
        title: what was measured, such as "Depth restoration".
        summary: HTML, a sentence for the head of the page.
        sections: of the page, in their order.
        answer: HTML, what the task says to whether restoring depth helps, and how sure that is;
            empty if it has nothing to say.
        terminal: tables as text.
        files: further files by name, written beside the page.
    """

    title: str
    summary: str
    sections: Sequence[PageSection]
    answer: str = ""
    terminal: str = ""
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ReportTask:
    """A task that reports know.

    Attributes:
        manifest: name of a file that the folder of every run of this task holds, and no other.
        make: `module:function` that makes the part of some folders of results. It is called with
            those that hold such a file, and with `published`: whether figures of papers stand
            beside the measured ones.
    """

    manifest: str
    make: str

    def part(self, folders: Sequence[Path], *, published: bool) -> ReportPart:
        """The part of these folders of results.

        Raises:
            ToolkitError: results that are damaged, or hold nothing.
        """
        module, _, name = self.make.partition(":")
        make: Callable[..., ReportPart] = getattr(importlib.import_module(module), name)
        return make(folders, published=published)


TASKS = (
    ReportTask(MANIFEST, "benchmark.report.depth_part:depth_part"),
    ReportTask(POSE_MANIFEST, "benchmark.report.pose_part:pose_part"),
    ReportTask(BOP_FILE, "benchmark.report.pose_part:bop_part"),
    ReportTask(GRASP_MANIFEST, "benchmark.report.grasp_part:grasp_part"),
)


def make_parts(folders: Sequence[Path], *, published: bool = True) -> list[ReportPart]:
    """The parts of all tasks that have results in these folders.

    Raises:
        ToolkitError: a folder has none, or what it has cannot be used.
    """
    holds = {
        task: [folder for folder in folders if next(folder.rglob(task.manifest), None) is not None]
        for task in TASKS
    }
    for folder in folders:
        if not any(folder in found for found in holds.values()):
            raise ToolkitError("no results of std-bench here", path=folder)
    return [task.part(found, published=published) for task, found in holds.items() if found]
