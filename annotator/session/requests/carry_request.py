"""Request that carries the poses of objects over from a scene of the same table."""

from __future__ import annotations

from pathlib import Path

from annotator.session.edits import AddObject, CompoundEdit, EnterModel, PoseChange, SetPoses
from annotator.session.edits.object_edits import Edit
from annotator.session.requests.mesh_requests import (
    Outcome,
    Request,
    RequestCancelled,
    Watch,
    known_models,
)
from annotator.session.state import Snapshot
from std_toolkit.errors import ToolkitError
from std_toolkit.io.locks import scene_lock
from std_toolkit.labels.carry.options import CarryOptions, Way
from std_toolkit.scene import ObjectTable, Scene


class CarryOver(Request, frozen=True, kw_only=True, tag="carry_over"):
    """Carries poses over from a labelled scene; fields as in `CarryOptions`.

    Attributes:
        source: folder of the scene that they are from.
    """

    source: str
    by: Way = "auto"
    board: str | None = None
    points: str | None = None
    objects: list[str] | None = None
    overwrite: bool = False

    @property
    def title(self) -> str:
        return f"Carry over from {Path(self.source).name}"

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        from std_toolkit.labels.carry.carry_step import carry_lines, plan_carry

        def check() -> None:
            if watch.cancelled():
                raise RequestCancelled("carrying over was cancelled")

        if not snapshot.writable:
            raise ToolkitError("the scene is open read-only", path=snapshot.scene.root)
        plan = plan_carry(
            snapshot.scene,
            Scene.open(Path(self.source).expanduser()),
            CarryOptions(
                by=self.by,
                board=None if self.board is None else Path(self.board).expanduser(),
                points=None if self.points is None else Path(self.points).expanduser(),
                objects=None if self.objects is None else tuple(self.objects),
                overwrite=self.overwrite,
            ),
            placed={o.name for o in snapshot.state.objects if o.placements},
            locked={o.name for o in snapshot.state.objects if o.locked},
            progress=watch.progress,
            check=check,
        )
        check()
        edits: list[Edit] = []
        changes = []
        table = snapshot.scene.objects
        with scene_lock(snapshot.scene.root):
            known = known_models(snapshot)
            for item in plan.objects:
                model = plan.copied(item, snapshot.scene.root, known)
                if item.model is None and model.id not in {m.id for m in table.models}:
                    edits.append(EnterModel(model=model))
                    known = ObjectTable(models=[*known.models, model], objects=known.objects)
                    table = ObjectTable(models=[*table.models, model], objects=table.objects)
                if item.known is None:
                    edits.append(
                        AddObject(object=item.name, model=model.id, material=item.source.material)
                    )
                changes.append(
                    PoseChange(
                        object=item.name,
                        frame=item.frame,
                        T_cam_obj=item.T_cam_obj.flat(),
                        method=plan.method,
                        refinement=plan.provenance,
                    )
                )
        edit = CompoundEdit(edits=[*edits, SetPoses(changes=changes)], label=self.title)  # type: ignore[list-item]
        lines = carry_lines(plan, snapshot.scene)
        report = [line for line in lines if not line.startswith("note: ")]
        count = "1 pose" if len(changes) == 1 else f"{len(changes)} poses"
        report.append(f"{count} carried over, judged now in this scene. Refine all comes next.")
        return Outcome(edit, report, plan.notes())
