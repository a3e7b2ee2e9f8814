"""Actions on objects: select, move by hand, refine, snap, points."""

from __future__ import annotations

from typing import TYPE_CHECKING

from annotator.app import action, operations, pose_checks
from annotator.app.view_options import Gizmo
from annotator.session import ChangeObject, RemoveObject
from std_toolkit.scene.model import Material

if TYPE_CHECKING:
    from annotator.app.controller import Controller


def _step(
    id: str, title: str, keys: tuple[str, ...], tip: str, **amount: tuple[float, float, float]
) -> action.Action:
    return action.Action(
        id,
        "Object",
        title,
        keys,
        tip,
        lambda c: c.nudge(**amount),
        problem=action.not_placed,
        repeats=True,
        group="Step",
    )


def _yaw(way: str, sign: int, key: str) -> action.Action:
    return action.Action(
        f"yaw_{way}",
        "Object",
        f"Turn {way} on the table",
        (key,),
        f"One step about the table's normal: the near side of the object moves to the {way}.",
        lambda c: c.yaw(sign),
        problem=action.not_placed,
        repeats=True,
        group="Step",
    )


def _next_gizmo(c: Controller) -> None:
    order = list(Gizmo)
    c.set_tool(gizmo=order[(order.index(c.gizmo) + 1) % len(order)])


def _set_step(size: float, title: str, key: str) -> action.Action:
    return action.Action(
        f"step_{title}",
        "Object",
        f"Steps of {size:g} mm and {size:g} deg",
        (key,),
        "How far one press of a key moves or turns the selected object.",
        lambda c: c.set_tool(step=size),
        lambda c: c.step == size,
        group="Step size and axes",
    )


def _set_gizmo(gizmo: Gizmo, title: str, key: str, tip: str) -> action.Action:
    return action.Action(
        f"gizmo_{gizmo}",
        "Object",
        title,
        (key,),
        tip,
        lambda c: c.set_tool(gizmo=gizmo),
        lambda c: c.gizmo is gizmo,
        group="Handles",
    )


def _set_material(material: Material, tip: str) -> action.Action:
    return action.Action(
        f"material_{material}",
        "Object",
        material.capitalize(),
        (),
        tip,
        lambda c: c.apply(ChangeObject(object=str(c.selected), material=material)),
        lambda c: c.selected is not None and c.session.object(c.selected).material == material,
        action.none_selected,
        group="Material",
    )


def _locked(c: Controller) -> bool:
    return c.selected is not None and c.session.object(c.selected).locked


OBJECT_ACTIONS: tuple[action.Action, ...] = (
    action.Action(
        "next_object",
        "Object",
        "Next object",
        ("N",),
        "Select the next object of the list.",
        lambda c: c.select_next(1),
        group="select",
    ),
    action.Action(
        "previous_object",
        "Object",
        "Previous object",
        ("P",),
        "Select the object before in the list.",
        lambda c: c.select_next(-1),
        group="select",
    ),
    _step("left", "Move left", ("Left",), "One step along -x.", shift=(-1, 0, 0)),
    _step("right", "Move right", ("Right",), "One step along x.", shift=(1, 0, 0)),
    _step("up", "Move up", ("Up",), "One step along -y.", shift=(0, -1, 0)),
    _step("down", "Move down", ("Down",), "One step along y.", shift=(0, 1, 0)),
    _step("away", "Move away", ("PgUp",), "One step along z: farther away.", shift=(0, 0, 1)),
    _step("nearer", "Move nearer", ("PgDown",), "One step along -z: nearer.", shift=(0, 0, -1)),
    _yaw("left", -1, "Shift+Left"),
    _yaw("right", 1, "Shift+Right"),
    _step("turn_x", "Turn about x", ("Shift+Up",), "One step about x.", turn=(1, 0, 0)),
    _step("turn_x_minus", "Turn about -x", ("Shift+Down",), "One step about -x.", turn=(-1, 0, 0)),
    _step("turn_z", "Turn about z", ("Shift+PgUp",), "One step about z.", turn=(0, 0, 1)),
    _step(
        "turn_z_minus", "Turn about -z", ("Shift+PgDown",), "One step about -z.", turn=(0, 0, -1)
    ),
    _step("turn_y", "Turn about y", ("Ctrl+Shift+Right",), "One step about y.", turn=(0, 1, 0)),
    _step(
        "turn_y_minus", "Turn about -y", ("Ctrl+Shift+Left",), "One step about -y.", turn=(0, -1, 0)
    ),
    _set_step(10.0, "coarse", "7"),
    _set_step(1.0, "middle", "8"),
    _set_step(0.1, "fine", "9"),
    action.Action(
        "axes",
        "Object",
        "Steps along the object's axes",
        ("A",),
        "Keyboard steps and handles follow the object's own axes instead of the camera's.",
        lambda c: c.set_tool(axes="camera" if c.axes == "object" else "object"),
        lambda c: c.axes == "object",
        group="Step size and axes",
    ),
    _set_gizmo(Gizmo.MOVE, "Handles to move", "W", "Arrows and a disc on the object: pull them."),
    _set_gizmo(Gizmo.TURN, "Handles to turn", "E", "Rings around the object: pull them."),
    _set_gizmo(Gizmo.OFF, "No handles", "Q", "Leave the handles out; the object can be dragged."),
    action.Action(
        "gizmo",
        "Object",
        "Next handles",
        ("G",),
        "Change the handles on the selected object: move, turn, none.",
        _next_gizmo,
        group="Handles",
    ),
    *(
        action.Action(
            f"flip_{axis}",
            "Object",
            f"Flip about {axis}",
            (f"Shift+{axis.upper()}",),
            f"Turn the object by 180 degrees about its own {axis} axis, such as a mug whose handle "
            "is on the wrong side.",
            lambda c, i=i: c.flip(i),  # type: ignore[misc]
            problem=action.not_placed,
            group="Flip",
        )
        for i, axis in enumerate("xyz")
    ),
    *(
        action.Action(
            f"quarter_{axis}",
            "Object",
            f"Quarter turn about {axis}",
            (f"Alt+{axis.upper()}",),
            f"Turn the object by 90 degrees about its own {axis} axis, such as one that was "
            "dropped lying instead of standing.",
            lambda c, i=i: c.flip(i, 90.0),  # type: ignore[misc]
            problem=action.not_placed,
            group="Flip",
        )
        for i, axis in enumerate("xyz")
    ),
    action.Action(
        "done",
        "Object",
        "Done",
        ("D",),
        "Mark the selected object as done, or as open again; asks if it is not known to fit.",
        pose_checks.toggle_done,
        lambda c: c.selected is not None and c.session.object(c.selected).status == "done",
        action.not_placed,
        group="state",
    ),
    action.Action(
        "lock",
        "Object",
        "Lock",
        ("L",),
        "Keep the pose of the selected object from being changed, or allow it again.",
        lambda c: c.apply(ChangeObject(object=str(c.selected), locked=not _locked(c))),
        _locked,
        action.none_selected,
        group="state",
    ),
    _set_material("raw", "The object's own, diffuse surface: the depth sensor is trusted on it."),
    _set_material("diffuse", "Sprayed or painted matt: the depth sensor is trusted on it."),
    _set_material("specular", "Shiny: the depth sensor is not trusted on it."),
    _set_material("transparent", "Clear: the depth sensor is not trusted on it."),
    action.dialog_action(
        "rename",
        "Object",
        "Rename...",
        ("F2",),
        "Give the selected object another name.",
        problem=action.none_selected,
        group="state",
    ),
    action.dialog_action(
        "note",
        "Object",
        "Note...",
        ("F3",),
        "Write down what is to be looked at again.",
        problem=action.none_selected,
        group="state",
    ),
    action.dialog_action(
        "symmetry",
        "Object",
        "Symmetry...",
        ("F4",),
        "Tell which turns of the mesh look the same: refining and comparing take it into account.",
        problem=action.none_selected,
        group="state",
    ),
    action.Action(
        "unplace",
        "Object",
        "Remove the pose",
        ("Del",),
        "Take the object's pose away; the object stays in the list.",
        operations.unplace,
        problem=action.not_placed,
        group="remove",
    ),
    action.Action(
        "remove_object",
        "Object",
        "Remove the object",
        ("Shift+Del",),
        "Take the object off the list, with its pose and points; the mesh stays in the library.",
        lambda c: c.apply(RemoveObject(object=str(c.selected))),
        problem=action.none_selected,
        group="remove",
    ),
)


def _no_points(c: Controller) -> str:
    """Say that the selected object has no clicked points in the frame of the active view."""
    if c.clicking or c.session.object(str(c.selected)).clicks.get(c.active_frame):
        return ""
    return f"no points of {c.selected} are clicked in frame {c.active_frame}"


ALIGN_ACTIONS: tuple[action.Action, ...] = (
    action.Action(
        "refine",
        "Align",
        "Refine",
        ("R",),
        "Fit the selected object: to the sensor depth and the image edges where it is opaque, to "
        "the edges in several frames where the sensor cannot see it.",
        operations.refine,
        problem=action.cannot_compute,
    ),
    action.Action(
        "refine_all",
        "Align",
        "Refine all objects",
        ("Ctrl+R",),
        "Fit all placed objects together.",
        lambda c: operations.refine(c, all_objects=True),
        problem=lambda c: (
            action.read_only(c)
            or action.blocked(c)
            or ("" if c.session.state.objects else "there are no objects yet")
        ),
    ),
    action.dialog_action(
        "carry",
        "Align",
        "Carry over from a scene...",
        ("Ctrl+L",),
        "Take the poses of the objects from a scene of the same table; they are judged here again.",
        problem=lambda c: (
            action.read_only(c)
            or action.blocked(c)
            or ("" if c.session.posed else "the scene has no metric camera poses")
        ),
    ),
    action.Action(
        "drop",
        "Align",
        "Drop onto the table",
        ("S",),
        "Move the object along the table's normal until it touches the table.",
        lambda c: operations.snap(c, "drop"),
        problem=action.cannot_compute,
    ),
    action.Action(
        "rest",
        "Align",
        "Lay onto the table",
        ("Shift+S",),
        "Turn the object so that it rests on its nearest side, and drop it onto the table.",
        lambda c: operations.snap(c, "rest"),
        problem=action.cannot_compute,
    ),
    action.Action(
        "take_turn",
        "Align",
        "Take the turn",
        ("Y",),
        "Turn the object to where its texture fits better, or scores higher.",
        pose_checks.take_turn,
        problem=pose_checks.no_turn,
    ),
    action.Action(
        "clicking",
        "Align",
        "Click points",
        ("C",),
        "Click a point on the mesh, then the same point in the image; four or more give a pose.",
        lambda c: c.set_tool(clicking=not c.clicking),
        lambda c: c.clicking,
        action.none_selected,
    ),
    action.Action(
        "solve_points",
        "Align",
        "Pose from the points",
        ("Return",),
        "Compute the pose from the clicked points (PnP) and show each point's residual.",
        operations.solve_points,
        problem=lambda c: action.none_selected(c) or action.blocked(c) or _no_points(c),
    ),
    action.Action(
        "residuals",
        "Align",
        "Measure residuals",
        ("M",),
        "Compare the selected object with the image edges and the depth in the shown frames.",
        operations.measure_residuals,
        problem=action.cannot_compute,
    ),
)
