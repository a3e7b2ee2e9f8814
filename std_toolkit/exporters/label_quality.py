"""What the check says of the labels of an export: refused, recorded, and told to readers."""

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.exporter import FrameRow, Target
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.scene.check_flags import CheckFlags
from std_toolkit.scene.label_verdicts import label_verdicts
from std_toolkit.scene.scene import Scene
from std_toolkit.scene.sidecar import LabelQuality, Quality

CARD_NAME = "dataset_info.md"


def label_quality(scene: Scene, flags: CheckFlags | None) -> Quality:
    """The verdicts on the labels of a scene, and the gates that it failed.

    Args:
        scene: the scene.
        flags: the last report; None if it does not belong to the present scene.
    """
    return Quality(
        checked=flags is not None,
        failed_gates=[] if flags is None else flags.gates,
        labels=[
            LabelQuality(
                object=v.object,
                name=v.name,
                grade=v.grade,
                probability=v.probability,
                deviation_mm=v.deviation_mm,
                deviation_deg=v.deviation_deg,
                reason=v.reason,
                failed_gates=[] if flags is None else flags.labels.get(v.object, []),
            )
            for v in label_verdicts(scene)
        ],
    )


def refuse_wrong(target: Target) -> None:
    """Check that no exported label is wrong and no gate of the scene failed.

    Raises:
        ToolkitError: one is, and `allow_wrong` is not set.
    """
    if target.options.allow_wrong:
        return
    quality, root = target.quality, target.scene.root
    wrong = [x for x in quality.labels if x.grade == "wrong" and x.object not in target.without]
    if wrong:
        raise ToolkitError(
            f"the label of {wrong[0].name} is wrong"
            if len(wrong) == 1
            else f"{len(wrong)} labels are wrong",
            path=root,
            value="; ".join(f"{x.name}: {x.reason}" for x in wrong),
            hint="correct them and run `std-curate run` again, leave them out (--only fits), or "
            "export them as they are (--allow-wrong)",
        )
    if quality.failed_gates:
        first = quality.failed_gates[0]
        raise ToolkitError(
            "the check of the scene failed",
            path=root,
            value="; ".join(map(str, quality.failed_gates)),
            hint=f"{first.advice}; or export the scene as it is (--allow-wrong)",
        )


def quality_lines(target: Target) -> list[str]:
    """Section of a data-set card in Markdown: grades, deviations and failed gates."""
    quality = target.quality
    lines = ["## Labels", ""]
    if not quality.checked:
        lines += ["No report of the check belongs to this state of the scene.", ""]
    for gate in quality.failed_gates:
        lines += [f"- Failed gate {gate}"]
    lines += [""] if quality.failed_gates else []
    lines += [
        "| object | exported | grade | probability | deviation | failed gates | reason |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in quality.labels:
        known = [
            f"{value:.2f} {unit}"
            for value, unit in ((row.deviation_mm, "mm"), (row.deviation_deg, "deg"))
            if value is not None
        ]
        cells = [
            row.name,
            "yes" if row.object in target.object_ids else "no",
            row.grade,
            "" if row.probability is None else f"{row.probability:.2f}",
            ", ".join(known),
            ", ".join(row.failed_gates),
            row.reason.replace("|", "/"),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def write_card(target: Target, rows: list[FrameRow]) -> list[str]:
    """Write the data-set card of a layout that has none; returns its path in the export."""
    lines = [
        f"# {target.scene.info.name}",
        "",
        f"{len(rows)} images, {len(target.model_ids)} models, written by std-toolkit "
        f"{__version__}.",
        "",
        *quality_lines(target),
    ]
    write_bytes_atomic(target.root / CARD_NAME, ("\n".join(lines) + "\n").encode())
    return [CARD_NAME]
