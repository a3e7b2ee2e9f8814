"""What a user types, and the runs that it means."""

from __future__ import annotations

import fcntl
import re
import shlex
from pathlib import Path

import pytest

from benchmark.evaluation import engine
from benchmark.evaluation.config import DepthConfig, PoseConfig
from benchmark.evaluation.tasks import pose
from benchmark.evaluation.tasks.depth import plan_runs
from std_toolkit.errors import ToolkitError


def config(**changes: object) -> DepthConfig:
    given: dict[str, object] = {
        "methods": ("swindrnet", "raw"),
        "splits": ("std-catknown", "dreds-catnovel"),
        "data": ("data",),
        "out": Path("results"),
    }
    return DepthConfig(**(given | changes))  # type: ignore[arg-type]


def test_every_method_meets_every_split_by_every_protocol() -> None:
    runs = plan_runs(config(protocols=("strict", "paper")))
    assert len(runs) == 8
    assert len({run.folder for run in runs}) == 8
    assert runs[0].folder == Path("results/std-catknown/swindrnet/strict")
    # One method after the other, so that each network is loaded once.
    assert [run.method for run in runs] == ["swindrnet"] * 4 + ["raw"] * 4


def test_a_split_may_have_a_folder_of_its_own() -> None:
    runs = plan_runs(config(data=("data", "dreds-catnovel=elsewhere")))
    assert {(run.split, str(run.root)) for run in runs} == {
        ("std-catknown", "data"),
        ("dreds-catnovel", "elsewhere"),
    }
    with pytest.raises(ToolkitError, match=r"no data for this split.*std-catknown"):
        plan_runs(config(data=("dreds-catnovel=elsewhere",)))


def test_an_equals_sign_in_the_name_of_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "a=b"
    folder.mkdir()
    assert plan_runs(config(data=(str(folder),)))[0].root == folder


def test_weights_and_settings_find_their_method() -> None:
    runs = plan_runs(
        config(
            weights=("swindrnet=model.pth",),
            settings=("swindrnet.fusion=released", "swindrnet.a=b=c"),
        )
    )
    assert runs[0].options.weights == Path("model.pth")
    assert runs[0].options.settings == {"fusion": "released", "a": "b=c"}
    assert runs[-1].options.weights is None
    one = plan_runs(config(methods=("nlspn",), weights=("w.pth",), settings=("steps=3",)))[0]
    assert (one.options.weights, one.options.settings) == (Path("w.pth"), {"steps": "3"})


def test_a_setting_goes_to_the_only_method_that_has_it() -> None:
    runs = plan_runs(config(settings=("fusion=released",)))
    assert [dict(run.options.settings) for run in runs[::2]] == [{"fusion": "released"}, {}]
    with pytest.raises(ToolkitError, match=r"which method.*one of nearest, telea$"):
        plan_runs(config(methods=("raw", "nearest", "telea"), settings=("grow_px=2",)))
    with pytest.raises(ToolkitError, match=r"which method.*one of raw, nearest$"):
        plan_runs(config(methods=("raw", "nearest"), settings=("nothing=2",)))


def test_every_pose_command_of_the_guides_can_be_planned() -> None:
    docs = Path(__file__).resolve().parents[3] / "docs"
    planned = 0
    for page in sorted(docs.glob("*.md")):
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for line in re.findall(r"std-bench pose [^`\n]*", text):
            words: dict[str, list[str]] = {}
            for word in shlex.split(line.partition(" #")[0])[2:]:
                if word.startswith("--"):
                    given = words.setdefault(word, [])
                else:
                    given.append(word)
            if "--method" not in words:
                continue
            names = {"methods": "--method", "settings": "--set", "weights": "--weights"}
            names |= {"depths": "--depth"}
            options = {k: tuple(words[o]) for k, o in names.items() if o in words}
            made = PoseConfig(splits=("scenes",), data=("x",), out=Path("o"), **options)
            assert pose.plan_runs(made), line
            planned += 1
    assert planned >= 5


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"weights": ("w.pth",)}, "weights.*w.pth.*METHOD="),
        ({"settings": ("nlspn.steps=3",)}, "settings"),
        ({"methods": ("raw",), "settings": ("steps",)}, "NAME=VALUE"),
        ({"methods": ("raw", "raw")}, "twice"),
        ({"label": "x"}, "one method"),
        ({"methods": ("raw",), "label": "../x"}, "folder"),
        ({"batch_size": 0}, "batch_size"),
        ({"limit": 0}, "limit"),
    ],
)
def test_what_cannot_be_meant_is_refused(changes: dict[str, object], told: str) -> None:
    with pytest.raises(ToolkitError, match=told):
        plan_runs(config(**changes))


def test_a_plug_in_has_a_label_that_can_be_a_folder() -> None:
    assert plan_runs(config(methods=("my.module:Class",)))[0].label == "my.module.Class"


def test_a_device_that_is_taken_is_not_given_again(tmp_path: Path, monkeypatch) -> None:
    devices = ("cuda:0", "cuda:1")
    with (tmp_path / "device-cuda-0.lock").open("w") as taken:
        fcntl.flock(taken, fcntl.LOCK_EX)
        assert engine.claim_device(devices, tmp_path) == "cuda:1"
        engine.claim_device.cache_clear()
        monkeypatch.setattr(engine, "_PATIENCE_S", 0.2)
        with pytest.raises(ToolkitError, match="more worker processes than devices"):
            engine.claim_device(devices, tmp_path)
    assert engine.claim_device(devices, tmp_path) == "cuda:0"
    engine.claim_device.cache_clear()


def test_labels_of_several_methods() -> None:
    runs = plan_runs(config(label=("swindrnet=ours", "raw=sensor"), splits=("std-catknown",)))
    assert [run.label for run in runs] == ["ours", "sensor"]
    one = plan_runs(config(methods=("raw",), label=("sensor",)))
    assert {run.label for run in one} == {"sensor"}
    beside = config(methods=("raw", "mine=out"), label=("sensor",), splits=("std-catknown",))
    assert [run.label for run in plan_runs(beside)] == ["sensor", "mine"]
    assert not plan_runs(beside)[1].speed


@pytest.mark.parametrize(
    ("label", "told"),
    [
        (("mine",), "names one method, not several"),
        (("raw=a", "raw=b"), "two names for one method"),
        (("raw=a/b",), "usable as a folder's name"),
        (("nlspn=a",), "names one method, not several"),
    ],
)
def test_wrong_labels(label: tuple[str, ...], told: str) -> None:
    with pytest.raises(ToolkitError, match=told):
        config(label=label)
    with pytest.raises(ToolkitError, match="two methods have this name"):
        plan_runs(config(label=("swindrnet=raw",)))
