"""A person at the annotator, scripted: places objects roughly, presses refine, marks them done.

Objects are placed in the first frame, either by clicking points of the mesh where the image shows
them, with a pixel of noise, or by hand, as far off as a newcomer leaves a mesh before refining.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from annotator.session import AddClick, ChangeObject, Click, Session, SetPoses
from annotator.session.requests import Refine, SolvePnP
from sensors.output.recording_writer import TrueObject, Truth, read_truth
from sensors.synthetic.truth import scene_from_truth
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import hull_vertices, load_mesh
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.geometry.symmetry import mssd, rotation_error
from std_toolkit.io.documents import write_document
from std_toolkit.labels.refine.caster import WorldCaster
from std_toolkit.labels.refine.problem import RefineObject
from std_toolkit.scene import Scene
from std_toolkit.scene.model import Labels

Start = Literal["clicks", "hand"]
CLICK_NOISE_PX = 1.0
FEWEST_CLICKS, MOST_CLICKS = 4, 8
# The largest error of a start by hand: of the object's centre, and of its rotation.
OFF_M, OFF_DEG = 0.03, 15.0


@dataclass(frozen=True)
class Attempt:
    """One object placed and refined.

    Attributes:
        start: how it was placed.
        views: number of images that the refinement saw.
        start_mm, start_deg: error as placed (MSSD and rotation, symmetry aware).
        mm, deg: the same after refining.
        seconds: that refining took; `cpu_seconds` of all threads.
    """

    seed: int
    name: str
    material: str
    start: Start
    views: int
    start_mm: float
    start_deg: float
    mm: float
    deg: float
    seconds: float
    cpu_seconds: float


def scene_to_annotate(recording: Path, out: Path, *, depth: bool) -> Scene:
    """The recording with true camera poses and nothing labelled, with its sensor depth or none."""
    scene = scene_from_truth(recording, out)
    scene.save_labels(Labels(labels=[]))
    if not depth:
        shutil.rmtree(out / "depth")
        frames = [msgspec.structs.replace(f, depth=None) for f in scene.frames]
        table = msgspec.structs.replace(scene.frame_table, frames=frames)
        write_document(out / "frames.json", table)
    return Scene.open(out)


class SimulatedAnnotator:
    """Annotates a scene made by `scene_to_annotate`, over and over.

    Args:
        recording: the truth.
        root: of the scene.
    """

    def __init__(self, recording: Path, root: Path) -> None:
        self._truth: Truth = read_truth(recording)
        self._root = root
        self._things = [_true_object(recording, item) for item in self._truth.objects]
        self._hulls = [hull_vertices(load_mesh(recording / o.mesh)) for o in self._truth.objects]

    def label(
        self, *, start: Start, frames: Sequence[int], seed: int, names: Sequence[str] | None = None
    ) -> list[Attempt]:
        """One object after the other is placed in the first of the frames and refined in all.

        Nothing is saved: the scene is as before.

        Args:
            names: of the objects; default: all.
        """
        attempts = []
        with Session.open(
            self._root, annotator="simulated", recover="no", by_hand=False
        ) as session:
            for k, thing in enumerate(self._things):
                if names is not None and thing.name not in names:
                    continue
                rng = np.random.default_rng([seed, k])
                if start == "clicks":
                    self._click(session, k, frames[0], rng)
                else:
                    self._drag(session, k, frames[0], rng)
                placed = self._error(session, k)
                began = time.perf_counter(), time.process_time()
                session.perform(Refine(objects=[thing.name], frame=frames[0], frames=list(frames)))
                seconds = time.perf_counter() - began[0]
                cpu_seconds = time.process_time() - began[1]
                session.apply(ChangeObject(object=thing.name, status="done"))
                attempts.append(
                    Attempt(
                        seed,
                        thing.name,
                        thing.material,
                        start,
                        len(frames),
                        *placed,
                        *self._error(session, k),
                        seconds,
                        cpu_seconds,
                    )
                )
            session.close(discard=True)
        return attempts

    def _click(self, session: Session, k: int, frame: int, rng: np.random.Generator) -> None:
        """Clicks until the points fix a pose; what does not say so is dragged there instead."""
        name = self._things[k].name
        points, pixels = self._visible_points(k, frame, rng)
        noisy = pixels + rng.normal(0, CLICK_NOISE_PX, pixels.shape)
        for done, (point, (u, v)) in enumerate(zip(points, noisy, strict=True), start=1):
            click = Click(u=float(u), v=float(v), point=point.tolist())
            session.apply(AddClick(object=name, frame=frame, click=click))
            if done < FEWEST_CLICKS + 2:
                continue
            try:
                session.perform(SolvePnP(object=name, frame=frame))
            except ToolkitError:
                continue
        if session.pose(name, frame) is None:
            self._drag(session, k, frame, rng)

    def _drag(self, session: Session, k: int, frame: int, rng: np.random.Generator) -> None:
        thing = self._things[k]
        shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        T = thing.T_world_obj
        R = so3_exp(axis * np.deg2rad(OFF_DEG)) @ T.R
        off = SE3(R, T @ thing.centre + OFF_M * shift - R @ thing.centre)
        T_cam_obj = self._truth.camera_pose(frame).inverse() @ off
        session.apply(SetPoses.one(thing.name, frame, T_cam_obj, method="drag"))

    def _visible_points(
        self, k: int, frame: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mesh points that the frame shows, far apart, mesh frame, and their exact pixels."""
        thing, camera = self._things[k], self._truth.camera.camera()
        T_world_cam = self._truth.camera_pose(frame)
        world = WorldCaster(self._things, [t.T_world_obj for t in self._things])
        T_cam_obj = T_world_cam.inverse() @ thing.T_world_obj
        pick = rng.choice(len(thing.vertices), min(2000, len(thing.vertices)), replace=False)
        p = T_cam_obj @ thing.vertices[pick]
        uv = camera.project(p)
        hits = world.cast(camera, T_world_cam, uv)
        shown = (hits.object == k) & (np.abs(hits.depth - p[:, 2]) < 0.002)
        shown &= ((uv > 3) & (uv < np.array(camera.size) - 4)).all(axis=1)
        points, pixels = thing.vertices[pick][shown], uv[shown]
        if len(points) < FEWEST_CLICKS:
            return points, pixels
        chosen = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())]
        nearest = np.full(len(points), np.inf)
        while len(chosen) < min(MOST_CLICKS, len(points)):
            nearest = np.minimum(nearest, np.linalg.norm(points - points[chosen[-1]], axis=1))
            chosen.append(int(nearest.argmax()))
        return points[chosen], pixels[chosen]

    def _error(self, session: Session, k: int) -> tuple[float, float]:
        """MSSD in mm and rotation in degrees, symmetry aware."""
        thing = self._things[k]
        there = session.T_world_obj(thing.name)
        assert there is not None
        far = mssd(there, thing.T_world_obj, self._hulls[k], thing.symmetry, steps=90)
        turn = rotation_error(there, thing.T_world_obj, thing.symmetry)
        return 1000 * far, float(np.rad2deg(turn))


def _true_object(recording: Path, item: TrueObject) -> RefineObject:
    mesh = load_mesh(recording / item.mesh)
    return RefineObject(
        item.name,
        np.asarray(mesh.vertices, dtype=np.float64),
        np.asarray(mesh.faces, dtype=np.int64),
        SE3.from_matrix(item.T_world_obj),
        item.material,
        item.symmetry.symmetry(),
    )
