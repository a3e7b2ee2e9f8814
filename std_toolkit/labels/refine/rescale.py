"""Camera poses in a scale that the refinement found."""

from __future__ import annotations

import msgspec

from std_toolkit.io.documents import read_document, write_document
from std_toolkit.scene.model import FramePose, ScaleEstimate, ScaleReport, pose_from_list
from std_toolkit.scene.provenance import Record, digest_file, record_path
from std_toolkit.scene.scene import Scene

SOURCE = "objects"


def rescale_poses(scene: Scene, factor: float, standard_error: float) -> None:
    """Write poses.json with all camera positions times `factor`; the caller holds the lock.

    The scale report gains an estimate called "objects". The record of the step that made the
    poses is brought up to date, so that a pipeline does not take them for tampered with and
    recover them again in the old scale.
    """
    poses = scene.poses
    assert poses is not None
    frames = [_rescaled(f, factor) for f in poses.frames]
    report = poses.scale or ScaleReport(unit="metre", chosen="given")
    before = next((e.factor for e in report.estimates if e.source == report.chosen), 1.0)
    estimate = ScaleEstimate(
        source=SOURCE,
        factor=before * factor,
        spread=standard_error,
        standard_error=standard_error,
        count=len(scene.labels.labels),
        note="sizes of the labelled objects, by `propagate --refine-scale`",
    )
    others = [e for e in report.estimates if e.source != SOURCE]
    scale = msgspec.structs.replace(report, chosen=SOURCE, estimates=[*others, estimate])
    path = scene.root / "poses.json"
    old = digest_file(path)
    scene.save_poses(msgspec.structs.replace(poses, frames=frames, scale=scale))
    _renew_records(scene, old, digest_file(path))


def _rescaled(frame: FramePose, factor: float) -> FramePose:
    if frame.T_world_cam is None:
        return frame
    T = pose_from_list(frame.T_world_cam)
    pose = T.flat()
    for i in range(3):
        pose[4 * i + 3] *= factor
    covariance = None
    if frame.covariance is not None:
        size = [factor] * 3 + [1.0] * 3
        covariance = [
            frame.covariance[6 * i + j] * size[i] * size[j] for i in range(6) for j in range(6)
        ]
    return msgspec.structs.replace(frame, T_world_cam=pose, covariance=covariance)


def _renew_records(scene: Scene, old: str, new: str) -> None:
    for path in sorted(record_path(scene.root, "x").parent.glob("*.json")):
        record = read_document(path, Record)
        if record.outputs.get("poses.json") == old:
            outputs = {**record.outputs, "poses.json": new}
            write_document(path, msgspec.structs.replace(record, outputs=outputs))
