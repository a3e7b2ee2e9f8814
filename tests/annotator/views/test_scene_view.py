"""What a view shows in its modes, styles and odd situations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import pyvista
import trimesh
from numpy.typing import NDArray
from views_desk import CAMERA, GREY, Desk

from annotator.app.view_options import CloudSource, Gizmo, Mode, Style
from annotator.session import AddClick, AddObject, ClearPose, Click, RemoveObject, SetPoses
from annotator.session.requests import ImportMesh
from annotator.views.layers import Captions
from std_toolkit.geometry import SE3
from std_toolkit.labels.support.plane import Plane, TablePlane

RING, BOX = (0, 114, 178), (230, 159, 0)  # of the palette
# Letters and handles have a few pixels of every hue.
NOTHING = 0.001


def said(desk: Desk, view: int = 0) -> str:
    """All text in a view."""
    captions: Captions = desk.views.views[view].captions
    return "\n".join(captions.texts())


def share(picture: NDArray[np.uint8], color: tuple[int, int, int]) -> float:
    """Share of the pixels of about this hue."""
    p = picture.astype(float) - picture.mean(axis=2, keepdims=True)
    c = np.array(color, float) - np.mean(color)
    length = np.linalg.norm(p, axis=2)
    alike = (p @ c) > 0.93 * length * np.linalg.norm(c)
    return float((alike & (length > 12)).mean())


class TestStyles:
    def test_solids_have_the_colours_of_the_report(self, desk: Desk) -> None:
        picture = desk.main.screenshot()
        assert share(picture, RING) > 0.02
        assert share(picture, BOX) > 0.01

    def test_opacity_lets_the_image_through_evenly(self, desk: Desk) -> None:
        desk.controller.set_tool(gizmo=Gizmo.OFF)
        pictures = {}
        for opacity in (1.0, 0.5):
            desk.controller.set_options(opacity=opacity)
            pictures[opacity] = desk.main.screenshot().astype(float)
        colored = np.ptp(pictures[1.0], axis=2) > 40
        colored[:60] = False
        mixed = 0.5 * pictures[1.0] + 0.5 * GREY
        # Also where a mesh is seen through the near side of another, or of itself.
        assert np.abs(pictures[0.5] - mixed)[colored].max() <= 2

    def test_hidden_meshes_leave_the_bare_image(self, desk: Desk) -> None:
        desk.controller.set_options(hidden=True)
        picture = desk.main.screenshot()
        assert share(picture, RING) < NOTHING and share(picture, BOX) < NOTHING
        assert desk.main.gizmo_frame() is None

    def test_only_the_selected_object(self, desk: Desk) -> None:
        desk.controller.select("box_1")
        desk.controller.set_options(only_selected=True)
        picture = desk.main.screenshot()
        assert share(picture, RING) < NOTHING and share(picture, BOX) > 0.01

    def test_a_wireframe_covers_little(self, desk: Desk) -> None:
        desk.controller.set_options(style=Style.SOLID)
        solid = share(desk.main.screenshot(), RING)
        desk.controller.set_options(style=Style.WIREFRAME)
        wire = share(desk.main.screenshot(), RING)
        assert 0.02 * solid < wire < 0.6 * solid

    def test_the_contour_may_be_added_to_solids(self, desk: Desk) -> None:
        before = desk.main.screenshot()
        desk.controller.set_options(contour_always=True)
        assert (desk.main.screenshot() != before).any()

    def test_the_selected_object_stands_out(self, desk: Desk) -> None:
        desk.controller.set_tool(gizmo=Gizmo.OFF)
        before = desk.main.screenshot()
        desk.controller.select("ring_1")
        after = desk.main.screenshot()
        white = (after.min(axis=2) > 240) & (before.min(axis=2) < 240)
        assert white.sum() > 200  # its silhouette
        assert "ring_1" in said(desk)

    def test_light_meshes_look_alike(self, desk: Desk) -> None:
        full = desk.main.screenshot().astype(int)
        desk.main.moving = True
        light = desk.main.screenshot().astype(int)
        assert (np.abs(full - light).max(axis=2) > 30).mean() < 0.01


class TestEditing:
    def test_a_removed_object_is_gone_and_comes_back(self, desk: Desk) -> None:
        desk.controller.apply(RemoveObject(object="box_1"))
        assert share(desk.main.screenshot(), BOX) < NOTHING
        desk.controller.undo()
        assert share(desk.main.screenshot(), BOX) > 0.01

    def test_an_object_without_a_pose_is_not_drawn(self, desk: Desk) -> None:
        desk.controller.apply(ClearPose(object="ring_1", frame=0))
        assert share(desk.main.screenshot(), RING) < NOTHING

    def test_clicked_points_and_residuals_are_drawn(self, desk: Desk) -> None:
        desk.controller.select("ring_1")
        desk.controller.set_tool(clicking=True)
        before = desk.main.screenshot()
        click = Click(u=60.0, v=60.0, point=[0.05, 0.0, 0.018])
        desk.controller.apply(AddClick(object="ring_1", frame=0, click=click))
        desk.settle()
        after = desk.main.screenshot()
        x, y = desk.main.screen_of_recorded(np.array([[60.0, 60.0]]))[0]
        changed = (after != before).any(axis=2)
        assert changed[int(y) - 12 : int(y) + 12, int(x) - 12 : int(x) + 12].any()
        # The pixel itself stays visible within its mark.
        assert not changed[int(y), int(x)]
        # A line leads from the pixel to the point.
        point = desk.main.screen.project(desk.pose() @ np.array(click.point))
        mx, my = ((x, y) + 2 * point) / 3
        assert changed[int(my) - 2 : int(my) + 3, int(mx) - 2 : int(mx) + 3].any()

    def test_penetration_is_painted_red(self, desk: Desk) -> None:
        from std_toolkit.labels.support.penetration import find_penetrations
        from std_toolkit.labels.support.solid import PlacedObject

        pose = desk.pose("ring_1")
        desk.controller.drag_to("box_1", 0, pose)
        desk.controller.end_drag()
        desk.settle()
        red = (237, 20, 26)
        assert share(desk.main.screenshot(), red) < NOTHING
        things = [
            PlacedObject(o.name, desk.session.mesh(o.model), desk.pose(o.name))
            for o in desk.session.state.objects
        ]
        desk.controller.penetrations = tuple(find_penetrations(things))
        assert share(desk.main.screenshot(), red) > 0.001
        desk.controller.set_options(penetration=False)
        assert share(desk.main.screenshot(), red) < NOTHING

    def test_penetration_is_painted_where_it_was_found(
        self, open_desk: Callable[..., Desk]
    ) -> None:
        """Without camera poses each frame has poses of its own."""
        from std_toolkit.labels.support.penetration import find_penetrations
        from std_toolkit.labels.support.solid import PlacedObject

        desk = open_desk({"posed": False})
        pose, red = desk.pose("ring_1"), (237, 20, 26)
        for name in ("ring_1", "box_1"):
            for frame in (0, 1):
                desk.session.apply(SetPoses.one(name, frame, pose, method="typed"))
        desk.settle()
        things = [
            PlacedObject(o.name, desk.session.mesh(o.model), pose)
            for o in desk.session.state.objects
        ]
        side = desk.views.views[1]
        without = side.screenshot()
        desk.controller.penetrations = tuple(find_penetrations(things))
        desk.controller.penetrations_frame = 0
        assert share(desk.main.screenshot(), red) > 0.001
        assert (side.screenshot() == without).all()
        desk.controller.penetrations_frame = 1
        assert share(desk.main.screenshot(), red) < NOTHING
        assert (side.screenshot() != without).any()


class TestCloud:
    def test_points_are_where_the_camera_saw_them(self, desk: Desk) -> None:
        image = desk.main.screenshot()
        desk.controller.set_mode(Mode.CLOUD)
        cloud = desk.main.screenshot()
        # The digits in the image's corner, as points.
        bright = (cloud[400:470, 10:60] > 115).all(axis=2)
        expected = (image[400:470, 10:60] > 115).all(axis=2)
        assert bright.any()
        assert (bright & expected).sum() > 0.6 * expected.sum()

    def test_without_depth_a_sentence_says_so(self, open_desk: Callable[..., Desk]) -> None:
        desk = open_desk({"depth": False})
        desk.controller.set_mode(Mode.CLOUD)
        assert "no sensor depth" in said(desk)
        assert share(desk.main.screenshot(), RING) > 0.02  # the meshes are there

    def test_many_frames_are_brought_together(self, desk: Desk) -> None:
        desk.controller.set_mode(Mode.CLOUD)
        desk.controller.set_options(cloud=CloudSource.FUSED)
        desk.settle()
        assert "many frames" in said(desk)
        assert desk.main.cloud is not None and desk.main.cloud.in_world
        assert len(desk.main.cloud.points) > 1000

    def test_without_camera_poses_there_are_only_the_points_of_the_frame(
        self, open_desk: Callable[..., Desk]
    ) -> None:
        desk = open_desk({"posed": False})
        desk.controller.set_options(cloud=CloudSource.FUSED)
        desk.controller.set_mode(Mode.CLOUD)
        assert desk.main.cloud is not None and not desk.main.cloud.in_world
        assert len(desk.main.cloud.points) > 1000

    def test_side_views_go_on_showing_the_image(self, desk: Desk) -> None:
        before = desk.views.views[1].screenshot()
        desk.controller.set_mode(Mode.CLOUD)
        assert (desk.views.views[1].screenshot() == before).all()

    def test_few_points_while_moving(self, desk: Desk) -> None:
        desk.controller.set_mode(Mode.CLOUD)
        desk.main.moving = True
        assert share(desk.main.screenshot(), RING) > 0.02

    def test_the_table_is_drawn_when_it_is_known(self, desk: Desk) -> None:
        desk.controller.set_mode(Mode.CLOUD)
        before = desk.main.screenshot()
        desk.controller.table = TablePlane(
            Plane(np.array([0.0, -1.0, -0.5]), 0.3),
            "depth",
            rms_m=0.001,
            points=100,
            frames=1,
            centre=np.array([0.0, 0.05, 0.5]),
            radius_m=0.4,
            uncertainty_m=0.002,
        )
        assert (desk.main.screenshot() != before).any()
        desk.controller.set_options(table=False)
        assert (desk.main.screenshot() == before).all()

    def test_cameras_of_the_other_views_are_drawn(self, desk: Desk) -> None:
        desk.controller.set_mode(Mode.CLOUD)
        desk.main.eye.shift(desk.main.T_ref_cam, np.array([0.3, 0.0, 1.2]))  # from behind them
        here = desk.main.screenshot()
        desk.controller.show_frame(3, view=1)
        assert (desk.main.screenshot() != here).any()


class TestOddSituations:
    def test_the_frame_is_named(self, desk: Desk) -> None:
        assert "Frame 0" in said(desk)
        assert "Frame 1" in said(desk, view=1)

    def test_a_frame_without_a_camera_pose_says_so(self, open_desk: Callable[..., Desk]) -> None:
        desk = open_desk({"unregistered": [3]})
        desk.controller.show_frame(3)
        assert "no camera pose" in said(desk)
        assert share(desk.main.screenshot(), RING) < NOTHING
        desk.controller.set_mode(Mode.CLOUD)
        desk.main.screenshot()

    def test_the_eye_does_not_stay_in_a_world_that_a_frame_does_not_know(
        self, open_desk: Callable[..., Desk]
    ) -> None:
        desk = open_desk({"unregistered": [3]})
        desk.controller.set_mode(Mode.CLOUD)
        desk.main.eye.shift(desk.main.T_ref_cam, np.array([0.1, 0.0, 0.2]))
        desk.controller.show_frame(2)
        assert desk.main.eye.T_eye_ref is not None  # it stays where it is in the world
        desk.controller.show_frame(3)
        assert desk.main.T_eye_cam.matrix() == pytest.approx(np.eye(4))
        assert desk.main.point_under(np.array([320.0, 240.0]))[2] == pytest.approx(0.8, abs=1e-3)

    def test_without_depth_the_points_of_the_reconstruction_are_shown(
        self, open_desk: Callable[..., Desk]
    ) -> None:
        import open3d as o3d

        desk = open_desk({"depth": False})
        points = np.random.default_rng(0).uniform([-0.3, -0.2, 0.7], [0.3, 0.2, 0.9], (500, 3))
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        cloud.colors = o3d.utility.Vector3dVector(np.tile([1.0, 0.2, 0.9], (500, 1)))
        path = desk.session.scene.root / "poses" / "points.ply"
        path.parent.mkdir(exist_ok=True)
        assert o3d.io.write_point_cloud(str(path), cloud)
        desk.controller.set_mode(Mode.CLOUD)
        assert "points of the reconstruction" in said(desk)
        assert desk.main.cloud is not None and len(desk.main.cloud.points) == 500
        assert share(desk.main.screenshot(), (255, 51, 230)) > 0.003

    def test_a_scene_without_objects_says_what_to_do(self, open_desk: Callable[..., Desk]) -> None:
        desk = open_desk({"objects": False})
        assert "Add the CAD mesh" in said(desk)
        assert "library" not in said(desk)  # which is empty
        assert "mesh" not in said(desk, view=1)

    def test_an_image_that_is_gone_leaves_a_sentence(self, desk: Desk) -> None:
        path = desk.session.scene.color_path(desk.session.scene.frame(4))
        path.unlink()
        desk.controller.show_frame(4)
        assert "000004.png" in said(desk)
        desk.controller.show_frame(2)
        assert "000004.png" not in said(desk)

    def test_a_mesh_that_is_gone_is_told(self, open_desk: Callable[..., Desk]) -> None:
        desk = open_desk()
        (desk.session.scene.root / "models/ring/ring.ply").write_bytes(b"ply\n")
        desk.session.scene._meshes.clear()
        from annotator.views.meshes import ShapeStore

        store = ShapeStore(desk.session.mesh)
        assert store.get(desk.session.state.model("ring")) is None
        assert "ring" in store.problems()

    def test_a_mesh_that_is_added_again_in_another_unit_is_drawn_anew(
        self, desk: Desk, tmp_path: Path
    ) -> None:
        path = tmp_path / "brick.obj"
        trimesh.creation.box((60.0, 40.0, 20.0)).export(path)

        def drawn_width(unit: str) -> float:
            desk.session.perform(ImportMesh(mesh=str(path), unit=unit))  # type: ignore[arg-type]
            pose = SE3(np.eye(3), np.array([0.0, 0.0, 2.0]))
            desk.session.apply(AddObject(object="brick", model="brick"))
            desk.session.apply(SetPoses.one("brick", 0, pose, method="typed"))
            desk.settle()
            solid = desk.main.solid("brick")
            assert solid is not None
            return float(np.ptp(solid.shape.bounds, axis=0)[0])

        assert drawn_width("mm") == pytest.approx(0.06)
        for _ in range(3):
            desk.controller.undo()
        assert drawn_width("cm") == pytest.approx(0.6)

    def test_another_size_of_the_window_keeps_the_middle(self, desk: Desk) -> None:
        for _ in range(5):
            desk.event("MouseWheelForward", (200, 100))
        middle = desk.main.window.to_image(np.array(desk.main.size) / 2)
        scale = desk.main.window.scale
        desk.plotters[0].render_window.SetSize(320, 240)
        desk.main.screenshot()
        assert desk.main.size == (320, 240)
        assert desk.main.window.scale == pytest.approx(scale / 2)
        assert desk.main.window.to_image((160, 120)) == pytest.approx(middle)

    def test_a_whole_image_stays_whole(self, desk: Desk) -> None:
        desk.plotters[0].render_window.SetSize(500, 300)
        desk.main.screenshot()
        corner = desk.main.window.to_screen((-0.5, -0.5))
        assert corner[1] == pytest.approx(0)
        assert desk.main.window.scale == pytest.approx(300 / CAMERA.height)

    def test_closing_leaves_the_plotter_empty(self, desk: Desk) -> None:
        desk.views.close()
        desk.views.close()
        window = desk.plotters[0].render_window
        fresh = pyvista.Plotter(off_screen=True)
        count = fresh.render_window.GetRenderers().GetNumberOfItems()
        fresh.close()
        assert window.GetRenderers().GetNumberOfItems() == count
        assert desk.plotters[0].renderer.GetViewProps().GetNumberOfItems() == 0
