"""What an import would find in its input, read, guess and ignore; nothing is written.

Readers say what they do in the log. A record's attribute `doctor` tells which of these it is; other
information counts as read, and a warning as ignored.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import MESH_SUFFIXES, load_mesh, mesh_extents, vertex_colors
from std_toolkit.importers import importer
from std_toolkit.importers.depth_survey import GuessedUnit
from std_toolkit.importers.foreign_files import is_ros_recording
from std_toolkit.importers.import_step import survey_recording
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.importers.options import ImportRequest, check_depth_numbers
from std_toolkit.log import logger
from std_toolkit.poses.camera_file import read_cameras
from std_toolkit.poses.known_cameras import read_known_poses
from std_toolkit.scene import Frame

# A recording of a phone may have a camera for each image.
_MOST_CAMERAS = 8

Kind = Literal["found", "read", "guessed", "ignored", "refused"]


@dataclass
class Report:
    """Rows of a report, in the order of reading.

    Attributes:
        rows: kind and sentence.
    """

    rows: list[tuple[Kind, str]] = field(default_factory=list)

    def add(self, kind: Kind, text: str) -> None:
        """Add a sentence, once."""
        if (kind, text) not in self.rows:
            self.rows.append((kind, text))

    @property
    def is_refused(self) -> bool:
        """Whether the import would stop."""
        return any(kind == "refused" for kind, _ in self.rows)

    def lines(self) -> list[str]:
        """The rows as text."""
        return [f"{kind:<8} {text}" for kind, text in self.rows]


def examine(request: ImportRequest, *, format_name: str | None = None) -> Report:
    """Examine a recording, a mesh, a file of intrinsics or one of camera poses.

    Args:
        request: as for an import.
        format_name: as for an import.

    Returns:
        The report; what would stop an import is a row of it.
    """
    report = Report()
    with _listening(report):
        try:
            check_depth_numbers(request)
            if request.color is None and request.source.is_file() and not _is_bag(request.source):
                _examine_file(request, report)
            else:
                _examine_recording(request, format_name, report)
        except GuessedUnit as error:
            report.add("guessed", f"depth unit: {error}")
            report.add("refused", "the unit of depth: state it with --depth-scale")
        except ToolkitError as error:
            report.add("refused", str(error))
    return report


def _is_bag(path: Path) -> bool:
    return is_ros_recording(path)


@contextmanager
def _listening(report: Report) -> Iterator[None]:
    """Rows of all that the readers log; nothing of it is printed."""

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            usual: Kind = "ignored" if record.levelno >= logging.WARNING else "read"
            report.add(getattr(record, "doctor", usual), record.getMessage())

    before, level = logger.handlers[:], logger.level
    logger.handlers[:] = [Listener(logging.INFO)]
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.handlers[:] = before
        logger.setLevel(level)


def _examine_recording(request: ImportRequest, format_name: str | None, report: Report) -> None:
    name = format_name or importer.format_of(request)
    report.add("found", f"format {name}")
    with TemporaryDirectory(prefix="std-doctor-") as workspace:
        if importer.needs_workspace(name, request.source):
            request = replace(request, workspace=Path(workspace))
        recording = importer.read_recording(name, request)
        for key, camera in list(recording.cameras.items())[:_MOST_CAMERAS]:
            count = sum(f.camera == key for f in recording.frames)
            report.add(
                "found",
                f"camera {key}: {camera.width}x{camera.height}, {count} frames, fx {camera.fx:.2f} "
                f"fy {camera.fy:.2f} cx {camera.cx:.2f} cy {camera.cy:.2f}",
            )
        if len(recording.cameras) > _MOST_CAMERAS:
            report.add("found", f"{len(recording.cameras) - _MOST_CAMERAS} more cameras")
        lost = [f.name for f in recording.frames if f.depth is None]
        if lost:
            more = " ..." if len(lost) > 5 else ""
            report.add("found", f"{len(lost)} frames without depth: {', '.join(lost[:5])}{more}")
        for note in recording.notes:
            report.add("ignored", note)
        survey = survey_recording(recording, stated=request.depth_scale, missing=request.missing)
        if survey is not None:
            first, *others = survey.lines()
            if survey.unread is not None:
                report.add("refused", first)
            else:
                report.add("guessed" if survey.origin == "guess" else "read", first)
            for line in others:
                report.add("ignored" if "no measurement" in line else "read", line)
            for line in survey.doubts():
                report.add("guessed", line)
        if request.known.cameras is not None:
            frames = [
                Frame(id=f.id, name=f.name, color=f"{f.color.target}{f.color.source.suffix}",
                      camera=f.camera, timestamp=f.timestamp)
                for f in recording.frames
            ]  # fmt: skip
            known = read_known_poses(request.known, frames)
            report.add("read", known.note())


def _examine_file(request: ImportRequest, report: Report) -> None:
    path = request.source
    if path.suffix.lower() in MESH_SUFFIXES:
        mesh = load_mesh(path, any_size=True, corners=False)
        size = " x ".join(f"{x:.4g}" for x in mesh_extents(mesh))
        material = getattr(mesh.visual, "material", None)
        images = (getattr(material, name, None) for name in ("image", "baseColorTexture"))
        colors = (
            "a texture"
            if any(image is not None for image in images)
            else "colours"
            if vertex_colors(mesh) is not None
            else "no colours"
        )
        report.add("found", f"mesh of {len(mesh.faces)} faces, {size} units, {colors}")
        return
    importer.refuse_other_programs(path)
    try:
        found = read_intrinsics(str(path), camera=request.camera)
    except ToolkitError as error:
        try:
            filed = read_cameras(path)
        except ToolkitError:
            raise error from None
        lost = f", {len(filed.lost)} lost" if filed.lost else ""
        report.add("found", f"camera poses ({filed.kind}): {len(filed.matrices)}{lost}")
        return
    size = "no image size" if found.size is None else f"{found.size[0]}x{found.size[1]}"
    numbers = f"fx {found.fx:.2f} fy {found.fy:.2f} cx {found.cx:.2f} cy {found.cy:.2f}"
    report.add("found", f"intrinsics: {numbers}, {size}")
