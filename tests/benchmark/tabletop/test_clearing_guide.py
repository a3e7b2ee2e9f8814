"""The planner of docs/grasp_methods.md runs as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest

from benchmark.methods.protocol import GraspView
from benchmark.methods.registry import MethodOptions
from benchmark.tabletop.grasp import execute
from tests.benchmark.tabletop.clearing_cases import CAMERA, TrueCamera, box, standing, table_object

GUIDE = Path(__file__).parents[3] / "docs" / "grasp_methods.md"


def test_the_planner_of_the_guide_grasps_a_tower():
    pytest.importorskip("mujoco")
    section = GUIDE.read_text().split("## Your own planner")[1]
    code = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert code is not None
    names: dict = {}
    exec(code[1], names)
    thing = box((0.04, 0.04, 0.09), "tower")
    camera = TrueCamera()
    observation = camera.observe([table_object(thing, 0)], [standing(thing)], 0, color=False)
    T_cam_table = camera.T_world_cam.inverse().matrix()
    view = GraspView(
        observation.frame.color, observation.frame.depth_true, CAMERA, T_cam_table=T_cam_table
    )
    grasps = names["Highest"](MethodOptions()).plan(view)
    assert len(grasps) == 1
    in_world = grasps.transformed(camera.T_world_cam)
    assert in_world.approaches[0] == pytest.approx([0, 0, -1], abs=1e-6)
    # The highest point seen may be any of the top; the jaw spans the tower from it all the same.
    assert abs(float(in_world.translations[0, 2]) - 0.09) < 1e-3
    assert execute([thing], [standing(thing)], in_world).outcome in ("held", "blocked-by-object")
    empty = GraspView(
        observation.frame.color, np.zeros_like(view.depth), CAMERA, T_cam_table=T_cam_table
    )
    assert len(names["Highest"](MethodOptions()).plan(empty)) == 0
