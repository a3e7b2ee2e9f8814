"""The splits of sets of transparent objects that third parties describe, or that are simulated."""

from benchmark.data.field.source import field_split
from benchmark.data.field.transpose import Part, Side, open_transpose
from benchmark.data.splits import Split


def _transpose(side: Side, part: Part) -> Split:
    name = f"transpose-{side}-{part}"
    folder = "test/seq_test_01" if part == "test" else "seq_H_01"
    return field_split(
        lambda root: open_transpose(name, root, side, part),
        name=name,
        about=f"real, {side} RGB-D camera, 99 transparent objects, {part} (experimental)",
        layout=f"ROOT/sequences/{folder}/cam_{side[0].upper()}/rgb/, depth/raw/, depth/rendered/, "
        "mask/, pose/, ROOT/models/",
        page="https://sites.google.com/view/transpose-dataset",
        card=(
            "experimental: layout by third parties; the authors published no loader; not checked "
            "on the files",
            "truth: rendered at the labels; its error is that of the labels; that it is 0 off the "
            "objects is not verified",
            "scored by the authors: not known; here on the objects' masks",
            "raw depth is depth/raw; depth/fixed, which some users restore from, is repaired",
            "not verified: the unit of the poses, here told by how far the objects are, and the "
            "poses of the arm",
            "train and test as the folders are; frames cut 60/40, as some users do, are no split "
            "of the authors",
            "licence: CC BY-NC-SA 4.0, as a third party quotes it",
        ),
    )


_SIDES: tuple[Side, ...] = ("right", "left")
_PARTS: tuple[Part, ...] = ("test", "train")
TRANSPOSE = {s.name: s for s in (_transpose(side, part) for side in _SIDES for part in _PARTS)}

GLASS = {**TRANSPOSE}
