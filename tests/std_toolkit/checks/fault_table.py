"""Known faults of a labelled scene, and what the check must say of each.

Every row puts one fault into a scene in memory and names the outcome: a failed check ("fail"), a
passed check with a warning that names the object ("warn"), or a passed check ("pass").
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.gates.judge import judge_scene
from std_toolkit.checks.inject.faults import Fault, FaultyScene, apply_fault
from std_toolkit.checks.measure.contours import LabelCaster, object_centre
from std_toolkit.checks.measure.object_sizes import measure_sizes
from std_toolkit.checks.measure.residuals import FrameObservation, measure_frame
from std_toolkit.checks.measure.textures import compare_textures
from std_toolkit.checks.result import CheckReport
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Frame, Scene
from std_toolkit.scene.model import pose_from_list

Wanted = Literal["pass", "warn", "fail"]
Array = NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class FaultCase:
    """One row of the table.

    Attributes:
        name: of the fault, in words.
        wanted: what the check must say; a failed check satisfies "warn", too.
        scene: the scene with the fault.
        about: words that the failed gates or the warnings must contain.
        frames: ids of the frames that have the fault; None: all.
        objects: ids of the objects that have it; None: all.
        sizes: whether the scale is measured by the sizes of the objects, which takes seconds.
    """

    name: str
    wanted: Wanted
    scene: Scene
    about: str = ""
    frames: tuple[int, ...] | None = None
    objects: tuple[int, ...] | None = None
    sizes: bool = False


@dataclass(frozen=True)
class Outcome:
    """What the check said.

    Attributes:
        said: the verdict in the words of `FaultCase.wanted`.
        text: failed gates and warnings.
    """

    said: Wanted
    text: str

    def satisfies(self, case: FaultCase) -> bool:
        """Whether this is what is wanted."""
        verdicts = ("warn", "fail") if case.wanted == "warn" else (case.wanted,)
        return self.said in verdicts and case.about in self.text


class BadFrames(FaultyScene):
    """A scene whose images or sensor depth differ from those on disk."""

    depth_of: Callable[[Frame], Frame] = staticmethod(lambda frame: frame)
    depth_factor = 1.0

    def read_depth(self, frame: Frame) -> NDArray[np.float32] | None:
        depth = super().read_depth(self.depth_of(frame))
        return None if depth is None else (depth * self.depth_factor).astype(np.float32)


class Study:
    """A scene with right labels, measured once, and the outcome of faults in it.

    Args:
        scene: the scene.
        options: limits.
        textured: ids of the objects whose textures are compared; None compares all.
    """

    def __init__(
        self,
        scene: Scene,
        options: CheckOptions | None = None,
        *,
        textured: Collection[int] | None = None,
    ) -> None:
        self.scene = scene
        self.options = options or CheckOptions()
        self.frames = scene.registered_frames()
        caster = LabelCaster.of_scene(scene)
        self.base = [measure_frame(scene, caster, f, self.options) for f in self.frames]
        self.textures = compare_textures(scene, self.frames, only=textured)

    def plain(self) -> CheckReport:
        """The report without a fault."""
        return self._report(self.scene, self.base, self.textures, sizes=True)

    def outcome(self, case: FaultCase) -> Outcome:
        """What the check says of a fault."""
        report = self.report(case)
        failed = report.failed_gates()
        words = [f"{g.key}: {g.detail}" for g in failed]
        words += [f"{w.about}: {w.problem}" for w in report.warnings]
        noted = [w for w in report.warnings if w.severity != "low"]
        names = [self.scene.objects.object(i).name for i in case.objects or ()]
        told = any(not names or w.about in names or names[0] in w.problem for w in noted)
        return Outcome("fail" if failed else "warn" if told else "pass", "; ".join(words))

    def report(self, case: FaultCase) -> CheckReport:
        """The report on the scene with a fault."""
        return self._report(*self.measured(case), sizes=case.sizes)

    def measured(
        self, case: FaultCase
    ) -> tuple[Scene, list[FrameObservation], Mapping[int, object]]:
        """The scene, the frames and the comparisons of textures that the judge reads."""
        caster = LabelCaster.of_scene(case.scene)
        observed = []
        for base, frame in zip(self.base, self.frames, strict=True):
            if case.frames is not None and frame.id not in case.frames:
                observed.append(base)
                continue
            again = measure_frame(case.scene, caster, frame, self.options, only=case.objects)
            observed.append(_merged(base, again, case.objects))
        # The texture is compared where all frames have the fault.
        textures = self.textures
        if case.frames is None and case.objects is not None:
            again = compare_textures(case.scene, self.frames, only=case.objects)
            textures = {**textures, **again}
        # The label of an object that moved is right in the other frames.
        scene = case.scene if case.frames is None or case.objects is None else self.scene
        return scene, observed, textures

    def _report(
        self,
        scene: Scene,
        observed: list[FrameObservation],
        textures: Mapping[int, object],
        *,
        sizes: bool,
    ) -> CheckReport:
        return judge_scene(
            scene,
            observed,
            {},
            self.options,
            up=UP,
            compared=textures,  # type: ignore[arg-type]
            sizes=measure_sizes(scene) if sizes else None,
        )


def _merged(
    base: FrameObservation, again: FrameObservation, only: tuple[int, ...] | None
) -> FrameObservation:
    if only is None:
        return again
    others = {i: o for i, o in base.objects.items() if i not in only}
    return replace(base, objects=dict(sorted((others | again.objects).items())))


def cases(scene: Scene) -> Iterator[FaultCase]:
    """The rows of the table for every object of a scene."""
    for item in scene.objects.objects:
        yield from _object_cases(scene, item.id, item.name, item.material)
    yield from _scene_cases(scene)


def _object_cases(scene: Scene, i: int, name: str, material: str) -> Iterator[FaultCase]:
    positions = [scene.T_world_cam(f.id).t for f in scene.registered_frames()]  # type: ignore[union-attr]
    along = object_centre(scene, i) - np.mean(positions, axis=0)
    along /= np.linalg.norm(along)
    symmetry = scene.objects.model_of(i).symmetry.symmetry()
    round_ = bool(symmetry.continuous)

    def put(kind: str, size: float) -> FaultyScene:
        return apply_fault(
            scene,
            Fault(kind, size, i, up=tuple(UP), along=tuple(along)),  # type: ignore[arg-type]
        )

    def case(what: str, wanted: Wanted, changed: Scene, **more: object) -> FaultCase:
        return FaultCase(f"{name} {what}", wanted, changed, objects=(i,), **more)  # type: ignore[arg-type]

    opaque = material == "diffuse"
    yield case("sideways 3 mm", "warn", put("sideways", 3))
    yield case("sideways 5 mm", "fail", put("sideways", 5))
    yield case("sideways -8 mm", "fail", put("sideways", -8))
    yield case("along 5 mm", "fail" if opaque else "warn", put("along", 5))
    yield case("along -6 mm", "fail" if opaque else "warn", put("along", -6))
    yield case("along 10 mm", "fail", put("along", 10))
    # Reflections hide small rotations of steel.
    shiny = material == "specular"
    if opaque:
        yield case("tilted 2 deg", "warn", put("tilt", 2))
    yield case("tilted 4 deg", "fail", put("tilt", 4))
    yield case(
        "tilted -10 deg" if shiny else "tilted -5 deg", "fail", put("tilt", -10 if shiny else -5)
    )
    if name == "soup_can":  # a cylinder without texture
        ambiguous = "ambiguous by geometry"
        yield case("upside down", "pass", put("tilt", 180), about=ambiguous)
    else:
        yield case("upside down", "fail", put("tilt", 180))
    yield case("on its side", "fail", put("tilt", 90))
    if not round_:
        if name == "cereal_box":
            yield case("turned 2 deg", "warn", put("turn", 2))
            yield case("turned 180 deg", "pass", put("turn", 180), about="ambiguous by geometry")
        yield case("turned 4 deg", "fail", put("turn", 4))
        yield case("turned 10 deg", "fail", put("turn", 10))
        yield case("turned -50 deg", "fail", put("turn", -50))
        yield case("turned 20 deg", "fail", put("turn", 20))
        yield case("turned 90 deg", "fail", put("turn", 90))
    if opaque:
        yield case("mesh 2 % too large", "warn", put("scale", 2))
    if not shiny:
        yield case("mesh 4 % too large", "fail", put("scale", 4))
        yield case("mesh 5 % too small", "fail", put("scale", -5))
    yield case("mesh 8 % too large", "fail", put("scale", 8))
    for mm in (30, 100, 300):
        yield case(f"{mm} mm beside", "fail", put("sideways", mm))
    frames = [f.id for f in scene.registered_frames()]
    half = len(frames) // 2
    for mm in (20, 12):
        moved = put("moved", mm)
        yield case(
            f"moved {mm} mm in the second half",
            "fail",
            moved,
            frames=tuple(frames[half:]),
            about="moved",
        )
    yield case(
        "moved 20 mm in frames 2 to 5",
        "fail",
        put("moved", 20),
        frames=tuple(frames[2:6]),
        about="moved",
    )


def _scene_cases(scene: Scene) -> Iterator[FaultCase]:
    frames = scene.registered_frames()
    for k, mm, deg in ((3, 30.0, 2.0), (len(frames) - 2, 20.0, 1.0), (0, 50.0, 0.0)):
        name = frames[k].name
        yield FaultCase(
            f"camera {k} off by {mm:g} mm, {deg:g} deg",
            "fail",
            _camera_off(scene, frames[k].id, mm, deg),
            about=name,
            frames=(frames[k].id,),
        )
    for px in (3, 5, 10):
        wanted: Wanted = "fail" if px >= 5 else "pass"
        yield FaultCase(
            f"depth shifted by {px} px",
            wanted,
            apply_fault(scene, Fault("alignment", px)),
            about="depth lies" if px >= 5 else "",
        )
    yield FaultCase("poses and labels 2 % too large", "warn", _scaled(scene, 1.02), sizes=True)
    yield FaultCase("all labels 5 mm along the view", "fail", _all_along(scene, 0.005))
    bad = BadFrames(scene)
    following = {f.id: frames[min(k + 1, len(frames) - 1)] for k, f in enumerate(frames)}
    bad.depth_of = lambda f: following[f.id]
    yield FaultCase("depth late by a frame", "fail", bad)
    bad = BadFrames(scene)
    bad.depth_factor = 1.04
    yield FaultCase("depth scaled by 1.04", "fail", bad)
    yield FaultCase("focal length 2 % off", "fail", _other_camera(scene, focal=1.02))
    yield FaultCase("principal point 5 px off", "fail", _other_camera(scene, shift=5.0))
    yield FaultCase("two objects swapped", "fail", _swapped(scene))
    yield FaultCase("the mesh of another object", "fail", _other_mesh(scene))


def _camera_off(scene: Scene, frame: int, mm: float, deg: float) -> FaultyScene:
    assert scene.poses is not None
    change = SE3(so3_exp(np.deg2rad([0, deg, 0])), np.array([mm / 1000, 0, 0]))
    poses = msgspec.structs.replace(
        scene.poses,
        frames=[
            msgspec.structs.replace(p, T_world_cam=(pose_from_list(p.T_world_cam) @ change).flat())
            if p.frame == frame and p.T_world_cam is not None
            else p
            for p in scene.poses.frames
        ],
    )
    return FaultyScene(scene, poses=poses)


def _scaled(scene: Scene, factor: float) -> FaultyScene:
    """Camera positions and label positions scaled about the origin of the world."""

    def larger(T: list[float]) -> list[float]:
        pose = pose_from_list(T)
        return SE3(pose.R, factor * pose.t).flat()

    assert scene.poses is not None
    poses = msgspec.structs.replace(
        scene.poses,
        frames=[
            msgspec.structs.replace(p, T_world_cam=larger(p.T_world_cam))
            for p in scene.poses.frames
            if p.T_world_cam is not None
        ],
    )
    labels = msgspec.structs.replace(
        scene.labels,
        labels=[
            msgspec.structs.replace(
                x, T_cam_obj=larger(x.T_cam_obj), T_world_obj=larger(x.T_world_obj)
            )
            for x in scene.labels.labels
            if x.T_world_obj is not None
        ],
    )
    return FaultyScene(scene, poses=poses, labels=labels)


def _all_along(scene: Scene, metres: float) -> FaultyScene:
    positions = [scene.T_world_cam(f.id).t for f in scene.registered_frames()]  # type: ignore[union-attr]
    labels = scene.labels
    for item in scene.objects.objects:
        label = scene.labels.of(item.id)
        assert label is not None and label.T_world_obj is not None
        along = object_centre(scene, item.id) - np.mean(positions, axis=0)
        pose = pose_from_list(label.T_world_obj)
        moved = SE3(pose.R, pose.t + metres * along / np.linalg.norm(along))
        labels = labels.with_label(msgspec.structs.replace(label, T_world_obj=moved.flat()))
    return FaultyScene(scene, labels=labels)


def _other_camera(scene: Scene, *, focal: float = 1.0, shift: float = 0.0) -> FaultyScene:
    faulty = FaultyScene(scene)
    cameras = {
        k: msgspec.structs.replace(c, fx=focal * c.fx, fy=focal * c.fy, cx=c.cx + shift)
        for k, c in scene.info.cameras.items()
    }
    faulty.info = msgspec.structs.replace(scene.info, cameras=cameras)
    return faulty


def _swapped(scene: Scene) -> FaultyScene:
    a, b = scene.objects.objects[0], scene.objects.objects[2]
    one, two = scene.labels.of(a.id), scene.labels.of(b.id)
    assert one is not None and two is not None
    labels = scene.labels.with_label(
        msgspec.structs.replace(one, T_world_obj=two.T_world_obj, T_cam_obj=two.T_cam_obj)
    )
    labels = labels.with_label(
        msgspec.structs.replace(two, T_world_obj=one.T_world_obj, T_cam_obj=one.T_cam_obj)
    )
    return FaultyScene(scene, labels=labels)


def _other_mesh(scene: Scene) -> FaultyScene:
    """The fourth object with the mesh of the second."""
    models = [o.model for o in scene.objects.objects]
    objects = msgspec.structs.replace(
        scene.objects,
        objects=[
            msgspec.structs.replace(o, model=models[1]) if k == 3 else o
            for k, o in enumerate(scene.objects.objects)
        ],
    )
    return FaultyScene(scene, objects=objects)
