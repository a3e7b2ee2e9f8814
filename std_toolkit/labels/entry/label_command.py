"""The label command, which checks all inputs before it writes anything."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from std_toolkit.commands import LabelCommand
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import load_mesh, mesh_bounds
from std_toolkit.geometry.se3 import SE3
from std_toolkit.geometry.symmetry import symmetry_words
from std_toolkit.labels.entry import label, pnp, pose_image, posefile, symmetry_argument
from std_toolkit.log import logger
from std_toolkit.scene import Frame, Scene, SymmetryModel
from std_toolkit.scene.document import check_name, safe_name
from std_toolkit.scene.frame_names import frame_title

if TYPE_CHECKING:
    import trimesh


def run_label_command(scene: Scene, command: LabelCommand) -> Iterator[str]:
    """Run the command and yield output lines. The caller holds the scene's lock.

    All inputs are read before the first write, so that an invalid pose file does not change the
    scene.

    Raises:
        ToolkitError: an input is invalid.
    """
    check_name(command.object, field="--object")
    known = next((o for o in scene.objects.objects if o.name == command.object), None)
    if known is None and command.mesh is None and command.model is None:
        raise ToolkitError(
            "no such object in the scene",
            field="--object",
            value=command.object,
            hint="give --mesh FILE (or --model ID of an existing model) to add it",
        )
    wanted = command.model or (safe_name(command.mesh.stem) if command.mesh is not None else None)
    if known is not None and wanted not in (None, known.model):
        raise ToolkitError(
            f"object {known.name} has model {known.model}",
            field="--model",
            value=wanted,
            hint=f"give --model {known.model}, or another name for --object",
        )
    frames = [scene.find_frame(given) for given in command.frames]
    if len({frame.id for frame in frames}) != len(frames):
        raise ToolkitError("a frame is given twice", field="--frame", value=command.frames)
    annotations = [_pose_of(scene, command, frame, i) for i, frame in enumerate(frames)]
    symmetry = _symmetry(scene, command, known.model if known is not None else None)
    yield from _enter_object(scene, command, symmetry)
    for i, (frame, (pose, method, found)) in enumerate(zip(frames, annotations, strict=True)):
        label.set_pose(
            scene,
            command.object,
            frame.id,
            pose,
            method=method,
            annotator=command.annotator,
            as_view=i > 0 or command.add_view,
        )
        position = ", ".join(f"{x:.4f}" for x in pose.t)
        yield f"{command.object}: pose set in {frame_title(frame)} ({method}), at ({position}) m"
        if found is not None:
            yield from _pnp_lines(found)


def _enter_object(
    scene: Scene, command: LabelCommand, symmetry: SymmetryModel | None
) -> Iterator[str]:
    known = next((o for o in scene.objects.objects if o.name == command.object), None)
    model_id = command.model or (known.model if known is not None else None)
    if command.mesh is not None:
        model = label.add_model(
            scene,
            command.mesh,
            mesh_unit=command.mesh_unit,
            category=command.category,
            symmetry=symmetry,
            model_id=command.model,
        )
        model_id = model.id
        size = " x ".join(f"{x * 1000:.1f}" for x in model.size_m)
        yield f"model {model.id}: {size} mm, diameter {model.diameter_m * 1000:.1f} mm"
        yield from _symmetry_lines(scene.mesh(model.id), command, model.symmetry)
    elif command.category is not None or symmetry is not None:
        raise ToolkitError(
            "category and symmetry are properties of a model", hint="give them together with --mesh"
        )
    assert model_id is not None
    if known is None or command.material is not None or command.mesh is not None:
        material = command.material or (known.material if known is not None else "diffuse")
        obj = label.add_object(scene, command.object, model=model_id, material=material)
        yield f"object {obj.name}: id {obj.id}, model {obj.model}, {obj.material}"


def _symmetry_lines(
    mesh: trimesh.Trimesh, command: LabelCommand, symmetry: SymmetryModel
) -> Iterator[str]:
    """Offer the symmetry of a mesh, or check the declared one."""
    if command.symmetry is not None and "auto" in command.symmetry:
        yield f"symmetry: {symmetry_words(symmetry.symmetry())}"
    elif command.symmetry is not None:
        doubt = symmetry_argument.symmetry_doubt(mesh, symmetry)
        if doubt is not None:
            logger.warning("model symmetry: %s", doubt)
    elif symmetry == SymmetryModel():
        proposal = symmetry_argument.symmetry_proposal(mesh)
        if proposal is not None:
            yield f"symmetry: none entered, but {proposal} (--symmetry auto enters the latter)"


def _pose_of(
    scene: Scene, command: LabelCommand, frame: Frame, index: int
) -> tuple[SE3, str, pnp.PnPResult | None]:
    if command.correspondences:
        points, pixels = pnp.read_correspondences(
            command.correspondences[index], unit=command.pose_unit or "m"
        )
        _check_pixels(scene, frame, pixels, command.correspondences[index])
        try:
            found = pnp.solve_pnp(
                points, pixels, scene.camera(frame), threshold_px=command.threshold_px
            )
        except ToolkitError as error:
            raise ToolkitError(
                error.problem,
                path=command.correspondences[index],
                value=error.value,
                hint=error.hint,
            ) from error
        return found.T_cam_obj, "pnp", found
    path = command.poses[index]
    pose = posefile.read_pose(
        path,
        format=command.pose_format,
        unit=command.pose_unit,
        convention=command.pose_convention,
        frame=command.pose_frame,
        item=command.pose_item,
        wanted=pose_image.WantedImage(frame, tuple(scene.frames)),
    )
    return pose, "file", None


def _check_pixels(scene: Scene, frame: Frame, pixels: np.ndarray, path: Path) -> None:
    width, height = scene.camera(frame).size
    outside = (pixels < -0.5).any(axis=1) | (pixels > [width - 0.5, height - 0.5]).any(axis=1)
    if outside.any():
        raise ToolkitError(
            f"a pixel is outside the {width}x{height} image",
            path=path,
            value=pixels[outside][0].tolist(),
            hint="are these pixels of another image size?",
        )


def _symmetry(scene: Scene, command: LabelCommand, model_id: str | None) -> SymmetryModel | None:
    if command.symmetry is None:
        return None
    if command.mesh is not None:
        mesh = load_mesh(command.mesh, unit=command.mesh_unit)
    else:
        mesh = scene.mesh(command.model or model_id or safe_name(command.object))
    centre = mesh_bounds(mesh).mean(axis=0).tolist()
    return symmetry_argument.parse_symmetry(command.symmetry, centre=centre, mesh=mesh)


def _pnp_lines(found: pnp.PnPResult) -> Iterator[str]:
    count = int(found.inliers.sum())
    yield (
        f"  PnP: {count} of {len(found.inliers)} correspondences fit, "
        f"rms {found.rmse_px:.2f} px; residuals "
        + " ".join(
            f"{r:.2f}" if ok else f"[{r:.1f}]"
            for r, ok in zip(found.residuals_px, found.inliers, strict=True)
        )
        + " px"
    )
    std = np.sqrt(np.diag(found.covariance))
    yield (
        f"  standard deviation {np.linalg.norm(std[:3]) * 1000:.1f} mm, "
        f"{np.rad2deg(np.linalg.norm(std[3:])):.2f} deg"
    )
