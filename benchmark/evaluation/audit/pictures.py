"""A picture of a label: its outline, and that of where the evidence puts the object."""

from __future__ import annotations

import cv2
import numpy as np

from benchmark.evaluation.audit.audit_scene import AuditScene, MovedScene
from std_toolkit.arrays import Array
from std_toolkit.checks.gates.located import Located
from std_toolkit.checks.measure.contours import LabelCaster
from std_toolkit.checks.measure.residuals import render_view
from std_toolkit.checks.result import ObjectCheck
from std_toolkit.errors import ToolkitError
from std_toolkit.scene import Frame, Scene

LABEL, MEASURED = (214, 39, 40), (44, 160, 44)  # RGB
_SIZE_PX, _MARGIN = 480, 0.35
_QUALITY = 85
_SHIFT = 4  # bits of a pixel in OpenCV's drawing


def picture_of(scene: AuditScene, item: ObjectCheck, at: Located | None) -> bytes | None:
    """The part of a frame around an object as JPEG; None where it is not visible.

    Args:
        scene: the judged frames.
        item: what the judge says of the object; the frame is that of its largest edge distance.
        at: where the evidence puts it.
    """
    seen = [f for f in item.frames if f.visible_fraction > 0]
    if not seen:
        return None
    frame = scene.frame(max(seen, key=lambda f: f.edge_px or 0.0).frame)
    loops = _outline(scene, frame, item.object)
    if not loops:
        return None
    try:
        image = scene.read_color(frame).copy()
    except ToolkitError:
        return None
    points = np.concatenate(loops)
    low, high = points.min(axis=0), points.max(axis=0)
    beside = max(_MARGIN * float((high - low).max()), 8.0)
    x0, y0 = np.maximum(np.floor(low - beside), 0).astype(int)
    x1, y1 = np.ceil(high + beside).astype(int)
    cut = np.ascontiguousarray(image[y0:y1, x0:x1])
    factor = _SIZE_PX / max(cut.shape[:2])
    part = cv2.resize(cut, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    measured = []
    if at is not None:
        measured = _outline(MovedScene.of(scene, {item.object: at}), frame, item.object)
    for outline, color in ((measured, MEASURED), (loops, LABEL)):
        for loop in outline:
            # Pixel centres are at whole numbers before and after.
            at = (loop - (x0, y0) + 0.5) * factor - 0.5
            fixed = np.rint(at * 2**_SHIFT).astype(np.int32)
            cv2.polylines(part, [fixed], isClosed=True, color=color, thickness=1,
                          lineType=cv2.LINE_AA, shift=_SHIFT)  # fmt: skip
    done, data = cv2.imencode(
        ".jpg", cv2.cvtColor(part, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
    )
    return data.tobytes() if done else None


def _outline(scene: Scene, frame: Frame, object_id: int) -> list[Array]:
    caster = LabelCaster.of_scene(scene)
    if object_id not in caster.object_ids:
        return []
    contour = render_view(scene, caster, frame).contour(object_id)
    return [] if contour is None else contour.loops
