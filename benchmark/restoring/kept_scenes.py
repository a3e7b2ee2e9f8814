"""Scenes that are made of recordings of ROS and librealsense, and kept beside the results."""

import logging
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.options import ImageOptions, ImportRequest
from std_toolkit.io.documents import digest_file, digest_files, digest_of, write_document
from std_toolkit.io.locks import hold_lock
from std_toolkit.jobs.artefact import Artefact, Record
from std_toolkit.scene.document import safe_name


def imported_scene(source: Path, images: ImageOptions, out: Path) -> Path:
    """The scene that `std-curate import` makes of a recording of ROS."""

    def make(scene: Path) -> None:
        request = ImportRequest(source=source, name=scene.name, **vars(images))
        import_recording(request, scene, format_name="ros")

    inputs = {"recording": _digest(source)}
    given = Path(images.intrinsics) if images.intrinsics else None
    if given is not None and given.is_file():
        inputs["intrinsics"] = digest_file(given)
    view = "" if images.undistort_fov is None else f"-fov{images.undistort_fov:g}"
    scene = out / "recordings" / safe_name(source.stem + view)
    return _kept_scene(scene, inputs, asdict(images), make)


def unpacked_scene(source: Path, out: Path) -> Path:
    """The scene that `std-record` makes of a file."""

    def make(scene: Path) -> None:
        unfinished = scene.with_name(f".{scene.name}.unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.parent.mkdir(parents=True, exist_ok=True)
        # A program of another package is called, not imported: the benchmark knows no camera.
        words = ["-m", "std_toolkit.cli.programs", "std-record"]
        words += [str(unfinished), "--name", scene.name, "--from"]
        done = subprocess.run(
            [sys.executable, *words, str(source)], capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            shutil.rmtree(unfinished, ignore_errors=True)
            lines = [line for line in done.stderr.splitlines() if line.strip()]
            raise ToolkitError(
                f"std-record cannot read it: {lines[-1].removeprefix('error: ') if lines else ''}",
                path=source,
            )
        unfinished.rename(scene)

    scene = out / "recordings" / safe_name(source.stem)
    return _kept_scene(scene, {"recording": digest_file(source)}, {}, make)


def _kept_scene(
    scene: Path,
    inputs: Mapping[str, str],
    options: Mapping[str, Any],
    make: Callable[[Path], None],
) -> Path:
    """A scene made of a file, made again if the file or an option changed.

    Raises:
        ToolkitError: the file cannot be read, or the scene is another process's or a link.
    """
    out = scene.parent.parent
    out.mkdir(parents=True, exist_ok=True)
    with hold_lock(out, "recordings", doing="writing to", what="folder", wait=True):
        record = scene.with_name(f".{scene.name}.json")
        artefact = Artefact(scene, scene.name, inputs, options)
        if artefact.find(record, Record, logging.INFO) is None:
            record.unlink(missing_ok=True)
            shutil.rmtree(scene, ignore_errors=True)
            make(scene)
            made = [p for p in scene.rglob("*") if p.is_file() and ".std" not in p.parts]
            write_document(record, artefact.record(made))
    return scene


def _digest(source: Path) -> str:
    """Digest of a file, or of all files of a folder by their names."""
    if source.is_file():
        return digest_file(source)
    files = sorted(p for p in source.rglob("*") if p.is_file())
    return digest_of(digest_files(source, files), versioned=False)
