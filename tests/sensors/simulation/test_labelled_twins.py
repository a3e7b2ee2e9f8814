"""Material twins: paired frames, labels as in the source, closed meshes."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from sensors.lighting.environment_sources import studio_map
from sensors.materials.material_draw import plain_look
from sensors.render.color_image import Lens
from sensors.render.sim_scene import SceneObject, SimScene, SurfaceMesh, TruthCaster
from sensors.simulation.cli import main
from sensors.simulation.labelled_scenes import find_labelled
from sensors.simulation.stills import plane_under, stills
from sensors.viewpoints.views import look_at
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.frame_maps import check_fresh
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.io.images import write_color
from std_toolkit.rendering.ground_truth import read_frame_truth, read_ground_truth
from std_toolkit.scene.model import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    Labels,
    Model,
    Object,
    ObjectTable,
    SceneInfo,
)
from std_toolkit.scene.scene import Scene

# 4:3 as the sensor knows, with a lens.
CAMERA = Camera(96, 72, 84.0, 84.0, 47.0, 36.0, (-0.12, 0.05, 0.001, 0.0))
# The world of the source is not that of the simulator.
T_WORLD_TABLE = SE3(so3_exp([0.4, -0.7, 1.1]), np.array([0.3, -0.2, 1.5]))
BOX, BALL = (0.09, 0.06, 0.12), 0.045
ON_TABLE = {
    3: SE3(so3_exp([0, 0, 0.5]), np.array([-0.06, 0.0, 0.06])),
    7: SE3(np.eye(3), np.array([0.07, 0.02, 0.045])),
}
VIEWS = [
    SE3(p.R, p.t)
    for p in (
        look_at(np.array([0.1, -0.45, 0.4]), np.zeros(3)),
        look_at(np.array([-0.3, -0.35, 0.35]), np.zeros(3)),
    )
]


def meshes() -> dict[str, trimesh.Trimesh]:
    """A coloured box without its bottom, and a ball off the origin of its frame."""
    box = trimesh.creation.box(BOX)
    box.update_faces(box.face_normals[:, 2] > -0.5)
    box.visual.vertex_colors = np.tile([200, 40, 30, 255], (len(box.vertices), 1))
    ball = trimesh.creation.icosphere(3, BALL)
    return {"box": box, "ball": ball}


def write_scene(root: Path, *, label_of_9: bool = False) -> Scene:
    """Three frames, the last without a camera pose; objects 3 and 7 with labels, 9 without."""
    models = []
    for name, mesh in meshes().items():
        path = root / f"models/{name}/{name}.ply"
        path.parent.mkdir(parents=True)
        mesh.export(path)
        models.append(
            Model(
                id=name, mesh=f"models/{name}/{name}.ply", category="other",
                size_m=[float(x) for x in mesh.extents], diameter_m=0.2,
            )
        )  # fmt: skip
    names = ["a0", "a5", "a9"]
    for name in names:
        write_color(root / f"color/{name}.png", np.zeros((72, 96, 3), np.uint8))
    scene = Scene.create(
        root,
        SceneInfo(name="desk", cameras={"color": CameraModel.of(CAMERA)}, source="import:folder"),
        Frames(
            frames=[
                Frame(id=i, name=n, color=f"color/{n}.png")
                for i, n in zip((0, 5, 9), names, strict=True)
            ]
        ),
        ObjectTable(
            models=models,
            objects=[
                Object(id=3, name="box_3", model="box", material="diffuse"),
                Object(id=7, name="ball_7", model="ball", material="diffuse"),
                Object(id=9, name="ball_9", model="ball", material="diffuse"),
            ],
        ),
    )
    cameras = [T_WORLD_TABLE @ T for T in VIEWS]
    scene.save_poses(
        CameraPoses(
            frames=[
                FramePose(frame=i, status="registered", T_world_cam=T.flat())
                for i, T in zip((0, 5), cameras, strict=True)
            ],
            source="import:folder",
        )
    )
    labels = []
    for i, T in ON_TABLE.items():
        world = T_WORLD_TABLE @ T
        labels.append(
            Label(
                object=i,
                frame=0,
                T_cam_obj=(cameras[0].inverse() @ world).flat(),
                T_world_obj=world.flat(),
            )
        )
    scene.save_labels(Labels(labels=labels))
    return scene


def write_bop(top: Path) -> Path:
    """The same frames in BOP's form, without images; the size is in camera.json."""
    folder = top / "test/000004"
    folder.mkdir(parents=True)
    (top / "models").mkdir()
    for number, mesh in enumerate(meshes().values(), start=1):
        scaled = mesh.copy()
        scaled.apply_scale(1000)
        scaled.export(top / f"models/obj_{number:06d}.ply")
    c = CAMERA
    (top / "camera.json").write_text(json.dumps({"width": c.width, "height": c.height}))
    K = [c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1]
    (folder / "scene_camera.json").write_text(json.dumps({"3": {"cam_K": K}, "8": {"cam_K": K}}))
    gt = {}
    for im_id, T_table_cam in zip(("3", "8"), VIEWS, strict=True):
        # Poses of the images disagree by a millimetre, as annotated ones do.
        off = SE3(np.eye(3), np.array([0.001 * (im_id == "8"), 0, 0]))
        found = [T_table_cam.inverse() @ off @ T for T in ON_TABLE.values()]
        gt[im_id] = [
            {"obj_id": k, "cam_R_m2c": T.R.ravel().tolist(), "cam_t_m2c": (1000 * T.t).tolist()}
            for k, T in enumerate(found, start=1)
        ]
    (folder / "scene_gt.json").write_text(json.dumps(gt))
    return folder


def test_a_scene_keeps_cameras_poses_and_names(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    scene = write_scene(tmp_path / "desk")
    with caplog.at_level("WARNING", logger="std_toolkit"):
        (where,) = find_labelled(tmp_path)
        found = where.read(10)
    assert (where.kind, where.name) == ("toolkit", "desk")
    assert [(f.id, f.name, f.camera) for f in found.frames] == [
        (0, "a0", CAMERA),
        (5, "a5", CAMERA),
    ]
    assert found.static and found.labels == scene.labels
    assert [o.id for o in found.objects] == [3, 7]
    assert "without a label: ball_9" in caplog.text and "without a pose: a9" in caplog.text
    # The whole range is kept where frames are left out.
    assert [f.id for f in where.read(1).frames] == [0]


def test_a_bop_scene_keeps_the_poses_of_each_image(tmp_path: Path) -> None:
    write_bop(tmp_path)
    (where,) = find_labelled(tmp_path)
    found = where.read(10)
    assert (where.kind, where.name, found.static) == ("bop", "000004", False)
    filed = json.loads((tmp_path / "test/000004/scene_gt.json").read_text())
    for frame in found.frames:
        for k, row in enumerate(filed[str(frame.id)], start=1):
            np.testing.assert_allclose(1000 * frame.T_cam_obj[k].t, row["cam_t_m2c"], atol=1e-9)
    assert found.labels.of(1).views.keys() == {"8"}  # type: ignore[union-attr]


def test_the_plane_is_under_the_objects(tmp_path: Path) -> None:
    write_scene(tmp_path / "desk")
    found = find_labelled(tmp_path)[0].read(10)
    (still,) = stills(found)
    T_plane_world = plane_under(found, still)
    for i, name in ((3, "box"), (7, "ball")):
        low = (T_plane_world @ still.T_own_obj[i] @ found.meshes[name].vertices)[:, 2].min()
        assert low == pytest.approx(0, abs=2e-4)
    # Up is up: the table's own normal.
    np.testing.assert_allclose((T_plane_world @ T_WORLD_TABLE).R[2], [0, 0, 1], atol=5e-3)


def test_a_sunken_label_lowers_the_plane(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scene = write_scene(tmp_path / "desk")
    T = T_WORLD_TABLE @ SE3(np.eye(3), np.array([0, 0, -0.02])) @ ON_TABLE[7]
    rows = [
        row
        if row.object != 7
        else Label(object=7, frame=0, T_cam_obj=row.T_cam_obj, T_world_obj=T.flat())
        for row in scene.labels.labels
    ]
    scene.save_labels(Labels(labels=rows))
    found = find_labelled(tmp_path)[0].read(10)
    (still,) = stills(found)
    with caplog.at_level("WARNING", logger="std_toolkit"):
        T_plane_world = plane_under(found, still)
    low = (T_plane_world @ T @ found.meshes["ball"].vertices)[:, 2].min()
    assert low == pytest.approx(0, abs=1e-6)
    assert "box_3 is 20 mm above the plane" in caplog.text


def test_images_of_a_lens_are_those_of_its_rays() -> None:
    """A picture that is a function of the ray is the same through the lens and in the pinhole."""
    lens = Lens.of(CAMERA)
    assert not lens.rendered.is_distorted

    def seen(camera: Camera) -> np.ndarray:
        x, y = np.moveaxis(camera.rays()[..., :2], -1, 0)
        return np.stack([x, y, x + y], axis=-1).astype(np.float32)

    np.testing.assert_allclose(lens.bent(seen(lens.rendered)), seen(CAMERA), atol=2e-4)
    plain = CAMERA.without_distortion()
    assert Lens.of(plain).rendered is plain


def test_a_lens_that_sees_too_wide_is_refused() -> None:
    wide = Camera(96, 72, 20.0, 20.0, 47.5, 35.5, (0.3, -0.05, 0.0, 0.002), "fisheye")
    with pytest.raises(ToolkitError, match="sees too wide"):
        Lens.of(wide)


BAD = {
    "no such folder": (["--scenes-from", "{0}/none", "--twins", "matt"], "no such folder", 1),
    "no scene": (["--scenes-from", "{0}", "--twins", "matt"], "no labelled scene here", 1),
    "drop": (["--twins", "matt"], "twins are of a folder", 2),
    "no twins": (["--scenes-from", "{0}"], "add --twins glass steel matt original", 2),
    "layout": (["--scenes-from", "{0}", "--twins", "matt", "--layout", "dreds"], "twins are", 2),
    "unknown": (["--scenes-from", "{0}", "--twins", "wood"], "wood", 2),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_wrong_names_are_one_line(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words, said, status = BAD[case]
    (tmp_path / "given").mkdir()
    words = [w.format(tmp_path / "given") for w in words]
    assert main(["run", "--out", str(tmp_path / "set"), *words]) == status
    told = capsys.readouterr().err
    assert (
        len([line for line in told.splitlines() if said in line]) == 1 and "Traceback" not in told
    )
    assert not (tmp_path / "set" / "scenes").exists()


def test_several_cameras_are_refused(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "desk")
    other = CameraModel.of(CAMERA.without_distortion())
    scene.save_info(SceneInfo(name="desk", cameras={**scene.info.cameras, "two": other}))
    path = tmp_path / "desk/frames.json"
    told = json.loads(path.read_text())
    told["frames"][1]["camera"] = "two"
    path.write_text(json.dumps(told))
    with pytest.raises(ToolkitError, match="several cameras"):
        find_labelled(tmp_path)[0].read(10)


@pytest.mark.slow
def test_twins_are_paired_and_keep_the_labels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mitsuba", reason="needs the extra [sim]")
    source = write_scene(tmp_path / "in/desk")
    out = tmp_path / "set"
    words = ["run", "--out", str(out), "--scenes-from", str(tmp_path / "in"), "--quality", "rough"]
    words += ["--engine", "serial", "--views", "2", "--twins", "glass", "original"]
    assert main(words) == 0
    glass, original = (Scene.open(out / "scenes" / t / "desk") for t in ("glass", "original"))
    assert [o.material for o in glass.objects.objects] == ["transparent"] * 2
    assert [o.material for o in original.objects.objects] == ["raw"] * 2
    for twin in (glass, original):
        assert twin.info.name == f"desk_{twin.root.parent.name}"
        assert twin.labels == source.labels
        assert [(f.id, f.name) for f in twin.frames] == [(0, "a0"), (5, "a5")]
        for frame in twin.frames:
            assert twin.T_world_cam(frame.id).flat() == source.T_world_cam(frame.id).flat()  # type: ignore[union-attr]
            check_fresh(twin, read_frame_truth(twin, frame.id))
            _check_on_mask_and_depth(twin, source, frame.id)
    for name in ("labels.json", "poses.json", "frames.json", "models/ball/ball.ply"):
        assert (glass.root / name).read_bytes() == (original.root / name).read_bytes()
    for kind in ("mask", "depth", "nocs", "normals"):
        for path in (glass.root / "gt" / kind).iterdir():
            assert path.read_bytes() == (original.root / "gt" / kind / path.name).read_bytes()
    # The box was closed, in both; the ball is the file of the source.
    assert not source.mesh("box").is_watertight
    closed = glass.mesh("box")
    closed.merge_vertices(merge_tex=True, merge_norm=True)
    assert closed.is_watertight and closed.volume == pytest.approx(np.prod(BOX))
    ball = "models/ball/ball.ply"
    assert (glass.root / ball).read_bytes() == (source.root / ball).read_bytes()
    # Red stays red, and glass is not.
    reds = [_redness(twin, 3) for twin in (original, glass)]
    assert reds[0] > 1.8 and reds[1] < 1.3
    # The same command keeps them; a changed source is told.
    capsys.readouterr()
    assert main(words) == 0
    assert "0 twins made, 2 kept, 0 failed" in capsys.readouterr().out
    moved = [
        Label(object=x.object, frame=0, T_cam_obj=x.T_cam_obj, T_world_obj=x.T_cam_obj)
        for x in source.labels.labels
    ]
    source.save_labels(Labels(labels=moved))
    assert main(words) == 1
    assert "changed since the twin was made" in capsys.readouterr().err


def _check_on_mask_and_depth(twin: Scene, source: Scene, frame_id: int) -> None:
    """The source's mesh at the source's pose falls on the twin's mask and depth."""
    truth = read_ground_truth(twin, frame_id)
    camera = twin.camera(twin.frame(frame_id))
    assert camera == CAMERA
    placed = []
    for i, name in ((3, "box"), (7, "ball")):
        T = source.T_cam_obj(frame_id, i)
        assert T is not None
        mesh = source.mesh(name)
        surface = SurfaceMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        placed.append(SceneObject(i, surface, T, plain_look("matt", 0)))
    far = SurfaceMesh(np.array([[0, 0, 90], [1, 0, 90], [0, 1, 90.0]]), np.array([[0, 1, 2]]))
    floor = SceneObject(0, far, SE3.identity(), plain_look("matt", 0))
    maps = TruthCaster(SimScene((floor, *placed), studio_map(1))).maps(camera, SE3.identity())
    inside = maps.mask > 0
    assert inside.sum() > 300
    np.testing.assert_array_equal(truth.mask, maps.mask)
    np.testing.assert_allclose(truth.depth[inside], maps.depth[inside], atol=1e-5)


def _redness(twin: Scene, object_id: int) -> float:
    frame = twin.frames[0]
    seen = read_ground_truth(twin, frame.id).mask == object_id
    inner = cv2.erode(seen.astype(np.uint8), np.ones((5, 5))) > 0
    color = twin.read_color(frame)[inner].astype(float).mean(axis=0)
    return float(color[0] / color[1])
