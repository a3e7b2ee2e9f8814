"""The splits of sets of transparent objects that third parties describe, or that are simulated."""

from benchmark.data.field.gn_trans import PARTS, open_gn_trans
from benchmark.data.field.gn_trans import Part as GnTransPart
from benchmark.data.field.rendered_todd import open_rendered_todd
from benchmark.data.field.source import field_split
from benchmark.data.field.syn_todd import open_syn_todd
from benchmark.data.field.todd import Part as ToddPart
from benchmark.data.field.todd import open_todd
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

_SYN_TODD = (
    "truth: exact, of the whole scene, cut at 3 m",
    "raw depth: none, 0 everywhere: no sensor was simulated. Methods that restore it have nothing "
    "to start from; those of colour alone have",
    "scored by others: every pixel from 0 to 3 m (--protocol full-frame), and the objects",
    "not verified: the axes of the poses, taken as Blender's because projections are mirrored in x",
    "the right images are not read: their users call them invalid",
    "licence: not found",
)
_SYN_TODD_FILES = ("https://doi.org/10.5683/SP3/LQKTXE",)


def _syn_todd(part: ToddPart) -> Split:
    name = f"syn-todd-{part}"
    return field_split(
        lambda root: open_syn_todd(name, root, part),
        name=name,
        about=f"simulated glass vessels, exact depth, {part}, as published (experimental)",
        layout=f"ROOT/synthetic_{part}_pkl/16300.pickle.zstd",
        page="https://github.com/ac-rad/MVTrans",
        download=_SYN_TODD_FILES,
        card=(
            "experimental: by the authors' loader; not checked on the files; pickles are read "
            "without running them; zstd needs Python 3.14, or `pip install backports.zstd`",
            *_SYN_TODD,
        ),
    )


_PARTS_OF_THREE: tuple[ToddPart, ...] = ("train", "val", "test")
SYN_TODD = {s.name: s for s in map(_syn_todd, _PARTS_OF_THREE)}
_RENDERED = field_split(
    lambda root: open_rendered_todd("syn-todd-rendered", root),
    name="syn-todd-rendered",
    about="simulated glass vessels, exact depth, as rendered (experimental)",
    layout="ROOT/163/Camera_0_EmptyVessel_Frame_0_RGB_L.jpg, BoundingBox.json",
    page="https://github.com/ac-rad/MVTrans",
    download=_SYN_TODD_FILES,
    card=("experimental: by the authors' loader; not checked on the files", *_SYN_TODD),
)


def _todd(part: ToddPart) -> Split:
    name = f"todd-{part}"
    return field_split(
        lambda root: open_todd(name, root, part),
        name=name,
        about=f"real D435i, glass vessels, {part} (experimental)",
        layout=f"ROOT/{part}/1622410107.5037992/image.jpg, depth.exr, detph_GroundTruth.exr",
        page="https://github.com/pairlab/TranspareNet",
        download=("https://doi.org/10.5683/SP3/ZJJAJ3",),
        card=(
            "experimental: by the authors' loaders; not checked on the files",
            "truth: rendered objects; what it is off them is not verified: only object pixels "
            "may be scored",
            "scored by the authors: at 320x240; which pixels is not verified; here the objects",
            "not verified: that 0 is the mask's background (one loader of the authors takes dark "
            "pixels for objects), and that the poses map objects to the camera",
            "licence: not found",
        ),
    )


TODD = {s.name: s for s in map(_todd, _PARTS_OF_THREE)}


def _gn_trans(part: GnTransPart) -> Split:
    name = f"gn-trans-{part}"
    numbers = PARTS[part]
    return field_split(
        lambda root: open_gn_trans(name, root, part),
        name=name,
        about=f"simulated D415, GraspNet's scenes {numbers[0]} to {numbers[-1]} with glass and "
        "metal, infrared pair (experimental)",
        layout=f"ROOT/scenes/{numbers[0]:05d}/0000_color.png, 0000_depth_sim.png, "
        f"ROOT/graspnet/virtual_scenes/scene_{numbers[0]:04d}/realsense/, scenes/, models/",
        page="https://github.com/jun7-shi/ASGrasp",
        card=(
            "experimental: folders by third parties, cameras by the authors' program; not checked "
            "on the files",
            "where to download the images is not known (asked in issue 4 of the page); truth, "
            "labels, poses and models are GraspNet-1Billion's, https://graspnet.net",
            "truth: of the whole scene, as far as GraspNet's virtual scenes have it; which camera "
            "it is of is told by raw depth, see the counts above",
            "scored by the authors: grasps; depth here with --protocol full-frame, or strict on "
            "the objects",
            "materials: not filed",
            "infrared: the pair is there, with the cameras of the authors' program",
            "licence: not found",
        ),
    )


GN_TRANS = {s.name: s for s in map(_gn_trans, PARTS)}

GLASS = TRANSPOSE | SYN_TODD | {_RENDERED.name: _RENDERED} | TODD | GN_TRANS
