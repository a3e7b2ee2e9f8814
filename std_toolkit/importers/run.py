"""The import step: choose the importer, read, write."""

from __future__ import annotations

from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.protocol import IMPORTERS, ImportRequest, LinkMode, detect_format
from std_toolkit.importers.staging import check_vacant
from std_toolkit.importers.writer import write_recording
from std_toolkit.jobs import JobOptions
from std_toolkit.scene.scene import Scene


def import_recording(
    request: ImportRequest,
    out: Path | str,
    *,
    format_name: str | None = None,
    link: LinkMode = "copy",
    options: JobOptions | None = None,
) -> Scene:
    """Import a recording as the new scene `out`.

    Args:
        request: what to read.
        out: scene folder; must not exist or be empty. It appears when everything is in it.
        format_name: importer's name; None recognises it by the marks of the layout, and takes
            separate colour images as "folder".
        link: see `write_recording`.
        options: where the frames are read and written.

    Raises:
        ToolkitError: the recording or the flags are wrong; nothing is left behind.
    """
    out = Path(out)
    check_vacant(out)
    if request.depth_scale is not None and not 0 < request.depth_scale <= 1:
        raise ToolkitError(
            "must be metres per unit of the depth images, above 0 and at most 1",
            field="--depth-scale",
            value=request.depth_scale,
            hint="millimetres: 0.001",
        )
    if not 0.8 < request.depth_correction < 1.25:
        raise ToolkitError(
            "must lie between 0.8 and 1.25",
            field="--depth-correction",
            value=request.depth_correction,
            hint="a calibrated factor such as 0.98; units are --depth-scale",
        )
    if format_name is None:
        format_name = "folder" if request.color else detect_format(request.source)
    recording = IMPORTERS.get(format_name).read(request)
    return write_recording(recording, out, name=request.name, link=link, options=options)
