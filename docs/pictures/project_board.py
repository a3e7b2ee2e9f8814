"""Makes docs/pictures/project_board.jpg: the board of a project of seven small recordings.

    python docs/pictures/project_board.py WORK

Records seven synthetic scenes in WORK (once), labels some of them as three people would, runs
`std-curate project run`, moves one label, reviews, and takes pictures of the page of its server:
light and dark, 1366 and 1920 pixels wide, the page of a scene, and the first one for the guide.
"""

from __future__ import annotations

import asyncio
import sys
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from annotator.web.board_app import BoardServer
from sensors.synthetic import RecordingOptions, make_recording
from sensors.synthetic.truth import scene_from_truth
from std_toolkit.cli.main import main as curate
from std_toolkit.geometry import SE3
from std_toolkit.io.images import read_color, write_color
from std_toolkit.project.queue import comment_scene, review_scene
from std_toolkit.project.record import Project
from std_toolkit.project.status import project_board
from std_toolkit.scene import Scene
from std_toolkit.scene.model import LabelProvenance, Labels

OUT = Path(__file__).with_suffix(".jpg")
OPTIONS = RecordingOptions(frames=6, width=640, height=360, arc_degrees=80.0)
# Who labelled how many objects of each scene.
SCENES: dict[str, tuple[str, int]] = {
    "table1": ("anna", 6),
    "table2": ("ben", 6),
    "table3": ("anna", 6),
    "shelf1": ("cleo", 6),
    "shelf2": ("ben", 4),
    "sink1": ("", 0),
    "sink2": ("", 0),
}
# A label that is moved after it was refined, and by how much, metres.
MOVED = ("table2", "glass", 0.012)
SIZES = ((1366, 768), (1920, 1080))


def make_scene(work: Path, name: str, seed: int) -> Path:
    """A scene with the labels of a person."""
    by, count = SCENES[name]
    root, recording = work / name, work / "recordings" / name
    if root.is_dir():
        return root
    make_recording(recording, replace(OPTIONS, seed=seed))
    scene = scene_from_truth(recording, root)
    labels = []
    for k, label in enumerate(scene.labels.labels[:count]):
        made = LabelProvenance(
            time=f"2026-11-2{seed}T{9 + k:02d}:12:00Z", tool="std-annotate", version="0",
            refinement="", hands_on_s=20.0 + 7 * k,
        )  # fmt: skip
        labels.append(msgspec.structs.replace(label, annotator=by, provenance=made))
    scene.save_labels(Labels(labels=labels))
    return root


def move(root: Path) -> None:
    """Move one label along the table, and check the scene again."""
    scene = Scene.open(root)
    labels = []
    for label in scene.labels.labels:
        if scene.objects.object(label.object).name == MOVED[1]:
            assert label.T_world_obj is not None
            pose = SE3.exp([MOVED[2], 0, 0, 0, 0, 0]) @ SE3.from_matrix(label.T_world_obj)
            label = msgspec.structs.replace(label, T_world_obj=pose.matrix().ravel().tolist())
        labels.append(label)
    scene.save_labels(Labels(labels=labels))
    for command in ("render", "check"):
        curate([command, str(root), "--workers", "1"])


def make_project(work: Path) -> Project:
    """The project, computed and partly reviewed."""
    folders = [str(make_scene(work, name, seed)) for seed, name in enumerate(SCENES, 1)]
    root = work / "mugs_and_glasses"
    if not (root / "project.json").is_file():
        words = ["--people", "anna", "ben", "cleo", "--twice-every", "0"]
        assert curate(["project", "create", str(root), "--scenes", *folders, *words]) == 0
        curate(["project", "run", str(root), "--workers", "1"])
        move(work / MOVED[0])
        project = Project.open(root)
        comment_scene(project, "table2", by="cleo", text="the handle is behind the bottle")
        review_scene(project, "shelf1", by="ben", send_back="the glass floats above the table")
    return Project.open(root)


async def take_pictures(project: Project, work: Path) -> None:
    """Serve the project to "anna", and take the pictures."""
    from playwright.async_api import async_playwright

    began: asyncio.Queue[int] = asyncio.Queue()
    server = BoardServer(project, {"picture": "cleo"})
    serving = asyncio.create_task(server.serve(host="127.0.0.1", port=0, started=began.put_nowait))
    url = f"http://127.0.0.1:{await began.get()}"
    async with async_playwright() as p:
        browser = await p.chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox"]
        )
        for scheme in ("light", "dark"):
            for width, height in SIZES:
                page = await browser.new_page(
                    viewport={"width": width, "height": height},
                    color_scheme=scheme,  # type: ignore[arg-type]
                )
                await page.goto(f"{url}/?token=picture")
                for path, name in (("/", "board"), ("/scenes/table2", "scene")):
                    await page.goto(url + path)
                    await page.wait_for_load_state("networkidle")
                    await page.screenshot(path=work / f"{name}_{scheme}_{width}.png")
                await page.close()
        await browser.close()
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)


if __name__ == "__main__":
    work = Path(sys.argv[1]).resolve()
    project = make_project(work)
    for row in project_board(project):
        print(row.name, row.stage, [(o.name, o.grade) for o in row.scene.objects])
    asyncio.run(take_pictures(project, work))
    write_color(OUT, np.ascontiguousarray(read_color(work / "board_light_1366.png")), quality=85)
