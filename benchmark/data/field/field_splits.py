"""The splits of the field's sets: where they are, how many frames they have, and what is known.

Experimental splits are read from layouts that only third parties describe, or that no file of the
authors was checked against.
"""

from benchmark.data.field.bop_frames import open_bop_frames
from benchmark.data.field.clearpose import PARTS, open_clearpose
from benchmark.data.field.glass_splits import GLASS
from benchmark.data.field.hammer import Sensor, open_hammer
from benchmark.data.field.housecat6d import open_housecat
from benchmark.data.field.nocs_sets import Set as NocsSet
from benchmark.data.field.nocs_sets import open_nocs
from benchmark.data.field.phocal import Part as PhoCaLPart
from benchmark.data.field.phocal import open_phocal
from benchmark.data.field.robi import open_robi
from benchmark.data.field.source import field_split as _split
from benchmark.data.field.transcg import Part, open_transcg
from benchmark.data.field.transcg import Sensor as TransCGSensor
from benchmark.data.frame import Material
from benchmark.data.splits import Published, Split


def _hammer(sensor: Sensor, title: str, *, test: bool) -> Split:
    part = "test" if test else "train"
    name = f"hammer-{sensor}-{part}"
    about = "nine test sequences" if test else "scenes 2 to 11"
    return _split(
        lambda root: open_hammer(name, root, sensor, test=test),
        name=name,
        about=f"real {title}, {about}, true depth of the whole scene (experimental)",
        layout=f"ROOT/scene12_traj1_1/[polarization/]rgb/, depth_{sensor}/, _gt/000000.png",
        page="https://github.com/Junggy/HAMMER-dataset",
        download=("https://www.campar.in.tum.de/public_datasets/2022_arxiv_jung/",),
        card=(
            "experimental: layout by third parties that agree; not checked on the authors' files",
            "truth: of the whole scene; score with --protocol full-frame, as users of the set "
            "do (no masks here)",
            "depth was warped into the polarisation camera: shadows of the warp are holes that "
            "no sensor made; the camera's own colour is not published",
            "licence: not stated",
        ),
    )


_SENSORS: dict[Sensor, str] = {"d435": "D435", "l515": "L515", "tof": "ToF camera"}
HAMMER = {
    split.name: split
    for split in (
        _hammer(sensor, title, test=test)
        for sensor, title in _SENSORS.items()
        for test in (True, False)
    )
}


def _clearpose(part: str) -> Split:
    name = f"clearpose-{part}"
    conditions = {"train": "training scenes", "test": "all test scenes"}
    about = conditions.get(part, part.replace("-", " "))
    return _split(
        lambda root: open_clearpose(name, root, part),
        name=name,
        about=f"real L515, 63 transparent objects, {about}",
        layout="ROOT/set1/scene1/000000-color.png, metadata.mat",
        page="https://github.com/opipari/ClearPose",
        published=(Published("README", 354_481, 51, of_more="all sets"),),
        card=(
            "truth: rendered objects pasted over the sensor's depth; off the objects it is the "
            "sensor, and only object pixels may be scored",
            "scored by the authors: not known; --protocol clearpose has every valid pixel, "
            "objects (label above 0) and transparent ones (1 to 63)",
            "the paper's test frames (2,000 a condition, random) are not published: say which "
            "frames are yours (--limit N)",
            "licence: MIT (README)",
        ),
    )  # fmt: skip


CLEARPOSE = {split.name: split for split in map(_clearpose, PARTS)}


def _transcg(sensor: TransCGSensor, part: Part, *, prepared: bool = False) -> Split:
    name = f"transcg-{sensor}-{part}{'-2022-10' if prepared else ''}"
    samples = 34_191 if part == "train" else 23_524
    how = ", frames as the release of October 2022 prepares them" if prepared else ""
    protocol = "transcg-2022-10" if prepared else "transcg"
    return _split(
        lambda root: open_transcg(name, root, sensor, part, prepared=prepared),
        name=name,
        about=f"real {sensor.upper()}, transparent objects, {part} scenes{how}",
        layout="ROOT/metadata.json, ROOT/scene1/0/rgb1.png",
        page="https://graspnet.net/transcg",
        published=(Published("metadata.json", samples, of_more=f"{part}, both cameras"),),
        card=(
            "truth: rendered objects pasted over the sensor's depth; off the objects it is the "
            "sensor, and only object pixels may be scored",
            f"scored by the authors: mask and valid truth at 320x240; --protocol {protocol}",
            *(
                (
                    "not verified: whether holes count in the mean and deviation by which raw "
                    "and true depth are cut; here they do",
                )
                if prepared
                else ()
            ),
            "licence: CC BY-NC-SA 4.0",
        ),
    )


TRANSCG = {
    split.name: split
    for split in (
        _transcg(sensor, part, prepared=prepared)
        for sensor in ("d435", "l515")
        for part in ("test", "train")
        for prepared in (False, True)
        if not (prepared and part == "train")
    )
}


def _bop(data: str, sensor: str, about: str, page: str, licence: str, material: Material) -> Split:
    name = f"{data}-val-{sensor}"
    return _split(
        lambda root: open_bop_frames(name, root, data, sensor, material),
        name=name,
        about=about,
        layout=f"ROOT/{data}/val/000000/depth_{sensor}/, scene_gt_{sensor}.json, "
        f"ROOT/{data}/models/",
        page=page,
        card=(
            "truth: rendered from the models at the labels, on visible masks; objects only; "
            "its error is that of the labels",
            "scored by the BOP Challenge: poses; depth restoration here on the visible masks",
            "split archives (.z01) need 7z",
            f"licence: {licence}",
        ),
    )


_XYZ = "https://huggingface.co/datasets/bop-benchmark/xyzibd"
_IPD = "https://huggingface.co/datasets/bop-benchmark/ipd"
BOP = {
    split.name: split
    for split in (
        *(
            _bop("xyzibd", s, f"real {s}, reflective metal parts", _XYZ, "CC BY-NC-SA 4.0",
                 Material.SPECULAR)
            for s in ("realsense", "xyz", "photoneo")
        ),
        _bop("ipd", "photoneo", "real photoneo, industrial parts (materials are not filed)", _IPD,
             "CC BY 4.0 (BOP edition)", Material.RAW),
    )
}  # fmt: skip


def _pace(part: str, about: str, unit: float | None) -> Split:
    name = f"pace-{part.replace('_', '-')}"
    return _split(
        lambda root: open_bop_frames(name, root, "pace", "", Material.RAW, part, unit),
        name=name,
        about=about,
        layout=f"ROOT/pace/{part}/000000/rgb/, depth/, mask_visib/, scene_gt.json, "
        "ROOT/pace/models/",
        page="https://github.com/qq456cvb/PACE",
        card=(
            "depth: " + ("0.1 mm a number" if unit else "the frame's depth_scale (1 mm)"),
            "truth: rendered from the models at the labels, on visible masks; objects only; "
            "its error is that of the labels (`std-bench audit`)",
            "scored by the authors: poses, of instances by bop_toolkit, of categories by AP; "
            "depth restoration here on the visible masks",
            "materials are not filed",
            "licence: MIT; models 693-1260 CC BY, 1165 and 1166 under GrabCAD's terms",
        ),
    )


PACE = {
    split.name: split
    for split in (
        _pace("test", "real, three cameras, 238 objects (whole set)", None),
        _pace("val_inst", "real, three cameras, the instances' validation", None),
        _pace("val_pbr_cat", "simulated, the categories' validation", 0.0001),
        _pace("train_pbr_cat", "simulated, training of categories", 0.0001),
        _pace("train_pbr_inst", "simulated, training of instances", 0.0001),
    )
}


def _housecat(part: str, scenes: int) -> Split:
    name = f"housecat6d-{part}"
    return _split(
        lambda root: open_housecat(name, root, part),
        name=name,
        about=f"real, polarisation camera, glass and cutlery among 10 classes, {part}",
        layout="ROOT/test_scene1/rgb/, depth/, instance/, labels/, "
        "ROOT/obj_models_small_size_final/",
        page="https://github.com/Junggy/HouseCat6D",
        card=(
            f"the set has {scenes} {part} scenes",
            "truth: rendered from the meshes at the labels; objects only; occluders that are "
            "no objects are not known",
            "scored by the authors: poses (3D IoU, degrees and cm) with true masks",
            "materials: glass as transparent, cutlery as specular; not filed by the authors",
            "licence: CC BY 4.0 (README)",
        ),
    )


def _phocal(part: PhoCaLPart) -> Split:
    name = f"phocal-{part}"
    return _split(
        lambda root: open_phocal(name, root, part),
        name=name,
        about=f"real, polarisation camera, glass and cutlery among 8 classes, {part} "
        "(experimental)",
        layout="ROOT/sequence_1/rgb/, depth/, mask/, rgb_scene_gt.json, train_test_split.npz, "
        "ROOT/class_obj_taxonomy.json, ROOT/obj_models_small_size/",
        page="https://arxiv.org/abs/2205.08811",
        card=(
            "experimental: layout by third parties; not checked on the files",
            "truth: rendered from the meshes at the labels; objects only; occluders that are "
            "no objects are not known",
            "scored by the authors: not known; here on the objects' masks",
            "train and test frames are of the same sequences",
            "materials: glass as transparent, cutlery as specular; not filed by the authors",
            "not verified: that test_idxs are numbers of frames, and that meshes are in metres",
            "licence: not found",
        ),
    )


PHOCAL = {s.name: s for s in (_phocal("train"), _phocal("test"))}
HOUSECAT = {s.name: s for s in (_housecat("train", 34), _housecat("val", 2), _housecat("test", 5))}


def _nocs(data: NocsSet, part: str, about: str) -> Split:
    name = f"{'real275' if data == 'Real' else 'camera25'}-{part}"
    scene = "scene_1" if data == "Real" else "00000"
    models = f"real_{part}/NAME.obj" if data == "Real" else f"{part}/SYNSET/MODEL/model.obj"
    pickled = {"test": "gts/real_test/", "val": "gts/val/"}.get(part)
    labels = "fitted to coordinates and depth, as the authors do"
    if pickled:
        labels = f"those of {pickled}; where there is none, {labels}"
    return _split(
        lambda root: open_nocs(name, root, data, part),
        name=name,
        about=about,
        layout=f"ROOT/{data}/{part}/{scene}/0000_color.png, _depth.png, _mask.png, _coord.png, "
        f"_meta.txt, ROOT/obj_models/{models}",
        page="https://github.com/hughw19/NOCS_CVPR2019",
        card=(
            "for poses: no pair of raw and true depth is published",
            "truth: rendered from the meshes at the labels, on masks; objects only; its error is "
            "that of the labels",
            f"labels: {labels}",
            "scored by the authors: poses and boxes of six classes; laptops are read and, as the "
            "benchmark has no such class, not scored",
            "materials are not filed",
            "numbers of frames: no source here states them, so what is complete is not known",
            *(("third parties miss files of 3,792 frames of val",) if part == "val" else ()),
            *(
                ()
                if data == "Real"
                else ("not verified: whether depth beside the colour image has the background",)
            ),
            "licence: non-commercial (code MIT)",
        ),
    )


NOCS = {
    split.name: split
    for split in (
        _nocs("Real", "test", "real, six classes, new instances"),
        _nocs("Real", "train", "real, six classes, training"),
        _nocs("CAMERA", "val", "synthetic objects on real tables, six classes, CAMERA25"),
        _nocs("CAMERA", "train", "synthetic objects on real tables, six classes, training"),
    )
}

ROBI = _split(
    lambda root: open_robi("robi-ensenso", root),
    name="robi-ensenso",
    about="real active stereo (Ensenso), chrome and steel parts, captured truth (experimental)",
    layout="ROOT/Zigzag/Scene_4/GT_Depth_Raw/DEPTH_view_0.png, Ensenso/Depth/, Ensenso/Stereo/",
    page="https://www.trailab.utias.utoronto.ca/robi",
    card=(
        "experimental: by the authors' toolkit; not checked on the files, whose folder of true "
        "depth it calls GT_Depth and GT_Depth_Raw",
        "truth: captured; all views of scenes 4, 5, 8, 9, some of the others; score with "
        "--protocol full-frame (no masks here)",
        "infrared: the pair with the projected pattern is there; poses are not read (their "
        "unit is not verified)",
        "licence: not found",
    ),
)

EVERY = (
    HAMMER | CLEARPOSE | TRANSCG | BOP | PACE | HOUSECAT | PHOCAL | NOCS | {ROBI.name: ROBI} | GLASS
)


def __getattr__(name: str) -> Split:
    """Each split as an attribute, for the registry: `HAMMER_D435_TEST` of `hammer-d435-test`."""
    for key, split in EVERY.items():
        if name == attribute_of(key):
            return split
    raise AttributeError(name)


def attribute_of(name: str) -> str:
    """Return the attribute of a split.

    >>> attribute_of("hammer-d435-test")
    'HAMMER_D435_TEST'
    """
    return name.upper().replace("-", "_")
