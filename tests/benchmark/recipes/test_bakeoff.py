"""`std-bench bakeoff`: what it concludes, where the truth is known by construction."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.data.splits import FrameKey
from benchmark.metrics.depth import harm
from benchmark.recipes.bakeoff import methods_at_hand
from benchmark.recipes.bakeoff_scenes import stage_scenes
from benchmark.recipes.bakeoff_surroundings import BakeoffSceneSettings, views_of
from benchmark.recipes.bakeoff_verdict import judge
from benchmark.recipes.bakeoff_words import conclusion
from std_toolkit.io.exr import read_exr_channel
from std_toolkit.scene import Scene
from std_toolkit.settings import override
from tests.benchmark.recipes.bakeoff_set import (
    GLASS,
    STEP_M,
    WALL,
    own,
    words_of,
    write_recording,
)
from tests.scene_on_disk import write_scene


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_recording(tmp_path_factory.mktemp("data") / "glass", vendor=True).root


def decide(
    capsys: pytest.CaptureFixture[str], recordings: list[Path], out: Path, *methods: str
) -> dict[str, Any]:
    words = ["bakeoff", *map(str, recordings), "--out", str(out), "--json", *words_of(*methods)]
    assert main(words) == 0
    return dict(json.loads(capsys.readouterr().out))


def without_vendor(tmp_path: Path, **changes: Any) -> list[Path]:
    return [write_recording(tmp_path / "data" / "plain", **changes).root]


def test_the_better_method_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = decide(capsys, without_vendor(tmp_path), tmp_path / "out", "Poor", "Good")
    assert (found["kind"], found["method"]) == ("use", own("Good"))
    ranking = found["rankings"]["transparent"]
    assert ranking["errors"][own("Good")]["mean"] == pytest.approx(0.005, abs=1e-6)
    assert ranking["behind"][own("Poor")]["mean"] == pytest.approx(0.045, abs=1e-6)
    assert ranking["units"] == 9 and found["unit"] == "view"
    assert f"Use {own('Good')}: RMSE 5.0 mm (5.0 to 5.0)" in found["conclusion"]
    # The sensor itself is as good as any on the opaque plate: all of them keep it.
    assert set(found["rankings"]["diffuse"]["tied"]) == {"raw", own("Good"), own("Poor")}
    page = (tmp_path / "out" / "bakeoff.html").read_text()
    assert found["conclusion"].partition(":")[0] in page
    assert "not for other objects" in page


def test_fewer_frames_than_the_recording_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    [rec] = without_vendor(tmp_path)
    words = ["bakeoff", str(rec), "--out", str(tmp_path / "out"), "--json", "--limit", "8"]
    assert main([*words, *words_of("Poor", "Good")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["method"] == own("Good")
    assert found["rankings"]["transparent"]["units"] == 8
    scored = Scene.open(tmp_path / "out" / "scenes" / rec.name)
    poses = Scene.open(rec).poses
    assert poses is not None and scored.poses is not None
    ids = {frame.id for frame in scored.frames}
    assert scored.poses.frames == [pose for pose in poses.frames if pose.frame in ids]
    before = (tmp_path / "out" / "bakeoff.html").read_bytes()
    assert main([*words[:-1], "5", *words_of("Poor", "Good")]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "other frames of this recording (got '8 frames, now 5'); give the --limit of" in line
    assert len(Scene.open(tmp_path / "out" / "scenes" / rec.name).frames) == 8
    assert (tmp_path / "out" / "bakeoff.html").read_bytes() == before


@pytest.mark.parametrize(("first", "second"), [("Good", "Near"), ("Random", "OtherRandom")])
def test_equal_methods_are_not_decided(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], first: str, second: str
) -> None:
    found = decide(capsys, without_vendor(tmp_path), tmp_path / "out", first, second)
    assert (found["kind"], found["method"]) == ("undecided", "")
    assert set(found["rankings"]["transparent"]["tied"]) == {own(first), own(second)}
    assert found["conclusion"].startswith("These frames do not decide between")
    # Both are better than nothing at all, which is said by their absence in the tie.
    assert found["rankings"]["transparent"]["behind"]["raw"]["low"] > 0.5


def test_harm_to_the_table_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rec = without_vendor(tmp_path)
    found = decide(capsys, rec, tmp_path / "out", "Good", "Harmful")
    assert (found["kind"], found["method"]) == ("on objects", own("Harmful"))
    # 5 % are more than twice max(3 mm, 1 %): every pixel that was right is wrong.
    for region in ("harm_opaque", "harm_background", "harm_band"):
        assert found["harms"][own("Harmful")][region]["mean"] > 0.99
        assert found["harms"][own("Good")][region]["mean"] == 0
    text = found["conclusion"]
    assert "not for whole frames" in text and "on the background" in text
    assert f"For whole frames use {own('Good')}" in text
    alone = decide(capsys, rec, tmp_path / "alone", "Harmful")
    assert alone["conclusion"].endswith("is better than the sensor's own depth.")


def test_the_sensor_may_be_best(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rec = [write_recording(tmp_path / "opaque", glass=False).root]
    found = decide(capsys, rec, tmp_path / "out", "Harmful")
    assert found["main"] == "all" and "transparent" not in found["rankings"]
    assert found["rankings"]["diffuse"]["errors"]["raw"]["mean"] > 0.4  # the plate is a hole
    assert found["method"] == own("Harmful") and found["kind"] == "on objects"


def test_one_view_decides_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rec = without_vendor(tmp_path, step=0.0)
    found = decide(capsys, rec, tmp_path / "out", "Good", "Poor")
    assert found["kind"] == "undecided" and found["units"] == 1
    assert "over 1 view." in found["conclusion"]
    assert "7 views or more" in found["conclusion"]


def test_the_cameras_own_depth_and_folders(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The stream beside the recording, in the recording's unit, and predictions in a folder."""
    mine = tmp_path / "mine" / "glass"
    mine.mkdir(parents=True)
    for i in range(9):
        np.save(mine / f"{i:06d}.npy", np.full((72, 96), GLASS + 0.02, np.float32))
    folder = f"mine={tmp_path / 'mine'}"
    found = decide(capsys, [recording], tmp_path / "out", "Poor", folder)
    assert (found["kind"], found["method"]) == ("use", "vendor.enhanced")
    errors = found["rankings"]["transparent"]["errors"]
    assert list(errors) == ["vendor.enhanced", "mine", own("Poor"), "raw"]
    assert errors["vendor.enhanced"]["mean"] < 1e-3
    assert errors["mine"]["mean"] == pytest.approx(0.02, abs=1e-6)
    again = decide(capsys, [recording], tmp_path / "out", "Poor", folder)
    assert again == found


def test_what_is_around_has_truth_of_other_views(recording: Path, tmp_path: Path) -> None:
    scenes = stage_scenes([recording], tmp_path, limit=9)
    assert scenes.around > 0.6 and len(set(scenes.views.values())) == 9
    maps = [
        read_exr_channel(scenes.root / "glass" / "reference" / "depth" / f"{i:06d}.exr")
        for i in range(9)
    ]
    for true in maps:
        # The wall, to the sensor's noise; at the plates' rims another view sees a plate instead.
        walls = true[(true > 0.95)]
        np.testing.assert_allclose(walls, WALL, atol=0.002)
        assert np.isin(
            true[10:30][(true[10:30] > 0) & (true[10:30] < 0.95)], np.float32(GLASS)
        ).all()
    with override(BakeoffSceneSettings(agreeing=10)):
        assert stage_scenes([recording], tmp_path / "none", limit=9).around == 0


def test_views_end_where_the_camera_has_moved(tmp_path: Path) -> None:
    scene = write_recording(tmp_path / "a", step=STEP_M / 2)
    assert views_of(scene, scene.frames) == [0, 0, 1, 1, 2, 2, 3, 3, 4]
    (tmp_path / "a" / "poses.json").unlink()
    again = Scene.open(tmp_path / "a")
    assert views_of(again, again.frames) == [0] * 9


def rows_of(method: str, errors: list[float], **changes: Any) -> pd.DataFrame:
    """Rows of one frame a scene."""
    told = {
        "method": method, "scene": [f"s{i}" for i in range(len(errors))], "frame": "0",
        "subset": "all", "rmse": errors, "n_pixels": 10, "error": "",
        **dict.fromkeys(harm.NAMES, np.nan),
    }  # fmt: skip
    return pd.DataFrame(told | changes)


def test_scenes_are_drawn_where_there_are_enough() -> None:
    good, poor = [0.01] * 8, [0.02] * 8
    views = {FrameKey(f"s{i}", "0"): "same" for i in range(8)}
    found = judge(pd.concat([rows_of("b", poor), rows_of("a", good)]), views)
    assert (found.kind, found.method, found.unit, found.units) == ("use", "a", "scene", 8)
    assert "do not tell" in conclusion(found)  # nobody knows what it breaks
    # With one scene against the others, the same means are not enough.
    one = judge(pd.concat([rows_of("a", good), rows_of("b", [0.09, *good[1:]])]), views)
    assert one.kind == "undecided"
    five = pd.concat([rows_of("a", good[:5]), rows_of("b", poor[:5])])
    assert judge(five, views).kind == "undecided"


def test_a_method_that_does_not_answer_does_not_compete() -> None:
    errors = ["", "", "cannot", *[""] * 5]
    rows = pd.concat(
        [
            rows_of("best", [0.001] * 8, error=errors),
            rows_of("a", [0.01] * 8),
            rows_of("b", [0.02] * 8),
        ]
    )
    found = judge(rows, {})
    assert found.method == "a" and found.left_out == {"best": "no answer to 1 of 8 frames: cannot"}
    alone = judge(rows[rows["method"] == "best"], {})
    assert alone.kind == "undecided" and "no method answered every frame" in conclusion(alone)
    one = judge(pd.concat([rows_of("raw", [0.1] * 8), rows[rows["method"] == "best"]]), {})
    assert one.kind == "undecided" and "fewer than two methods" in conclusion(one)
    empty = judge(rows_of("a", [np.nan] * 8, n_pixels=0), {})
    assert empty.kind == "undecided" and "no frame has a pixel" in conclusion(empty)


@pytest.mark.parametrize("harmed", [0.004, 0.03])
def test_the_limit_of_harm(harmed: float) -> None:
    rows = pd.concat(
        [
            rows_of("a", [0.01] * 8, harm_background=harmed, harm_opaque=0.0),
            rows_of("b", [0.02] * 8, harm_background=0.0, harm_opaque=0.0),
        ]
    )
    found = judge(rows, {})
    assert found.kind == ("use" if harmed < 0.01 else "on objects")
    text = conclusion(found)
    assert f"{100 * harmed:.1f} %" in text and "on the background" in text


def test_a_method_that_fails_is_reported_and_the_rest_decided(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["bakeoff", str(without_vendor(tmp_path)[0]), "--out", str(tmp_path / "out")]
    assert main([*words, *words_of("Good", "Poor", "Broken")]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"Use {own('Good')}")
    assert f"{own('Broken')} does not compete: no answer to 9 of 9 frames: " in out
    assert main([*words, *words_of("Good", "Poor", "Missing")]) == 1
    told = capsys.readouterr()
    assert told.out.startswith(f"Use {own('Good')}")
    assert "Missing" in told.err


@pytest.mark.slow
def test_the_methods_at_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All of them run without any further file, and are timed."""
    rec = without_vendor(tmp_path, frames=2)[0]
    assert main(["bakeoff", str(rec), "--out", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    names = {"raw", *methods_at_hand()}
    networks = {"swindrnet", "nlspn", "dfnet", "compactdr", "std-restore"}
    assert {"nearest", "colorization", *networks} < names
    assert set(found["rankings"]["transparent"]["errors"]) == names == set(found["costs"])
    assert all(cost["seconds"]["mean"] > 0 for cost in found["costs"].values())
    assert "processor time a frame of 640x480" in (tmp_path / "out" / "bakeoff.html").read_text()
    assert found["kind"] == "undecided"
    assert "9 views or more" in found["conclusion"]


def test_wrong_recordings(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    write_scene(tmp_path / "unlabelled")
    twin = write_recording(tmp_path / "x" / "glass").root
    write_recording(tmp_path / "y" / "x" / "glass")
    for recordings, told in (
        ([tmp_path / "empty"], "no toolkit scene here"),
        ([tmp_path / "unlabelled"], "no frame has sensor depth and ground truth"),
        ([recording, recording], "is given twice"),
        ([recording, recording.parent], "is given twice"),
        ([recording, twin, tmp_path / "y" / "x" / "glass"], "two recordings have this name"),
    ):
        words = ["bakeoff", *map(str, recordings), "--out", str(tmp_path / "o"), *words_of()]
        assert main(words) != 0
        lines = capsys.readouterr().err.strip().splitlines()
        assert len(lines) <= 2 and told in lines[0], lines
    assert main(["bakeoff", str(twin), "--out", str(tmp_path / "out"), *words_of("Good")]) == 0
    other = write_recording(tmp_path / "other").root
    assert main(["bakeoff", str(other), "--out", str(tmp_path / "out"), *words_of("Good")]) == 1
    assert "frames of another recording" in capsys.readouterr().err
