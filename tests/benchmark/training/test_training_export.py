"""Weights given away: half precision, digest and card tell the truth."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from benchmark.methods.registry import sha256_of
from benchmark.training.export import export_weights, half
from std_toolkit.errors import ToolkitError
from tests.benchmark.training.training_set import packed, trained, wishes, write_scenes


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export")
    pack = packed(folder / "pack", write_scenes(folder / "data"))
    trained(wishes("dfnet", pack), folder / "run")
    return folder / "run"


def test_numbers_are_those_of_the_best_weights_rounded(run: Path, tmp_path: Path) -> None:
    path = export_weights(run, tmp_path / "out")
    best, given = load_file(run / "best.safetensors"), load_file(path)
    assert path.name == "dfnet-compact.safetensors"
    assert best.keys() == given.keys()
    for name, tensor in best.items():
        if tensor.is_floating_point():
            torch.testing.assert_close(given[name].float(), tensor, rtol=1e-3, atol=1e-5)
        else:
            assert torch.equal(given[name], tensor)
    assert {t.dtype for t in given.values() if t.is_floating_point()} == {torch.float16}


def test_the_digest_is_that_of_the_file(run: Path, tmp_path: Path) -> None:
    path = export_weights(run, tmp_path)
    assert path.with_name(path.name + ".sha256").read_text().split() == [
        sha256_of(path),
        path.name,
    ]


def test_others_may_read_the_weights(run: Path, tmp_path: Path) -> None:
    umask = os.umask(0o022)
    try:
        path = export_weights(run, tmp_path)
    finally:
        os.umask(umask)
    assert path.stat().st_mode & 0o777 == 0o644


def test_the_card_tells_data_steps_machine_and_scores(run: Path, tmp_path: Path) -> None:
    card = export_weights(run, tmp_path, scores="| a | b |").with_suffix(".md").read_text()
    for told in (
        "dreds-catknown-train",
        "9 frames of 3 scenes",
        "32x32",
        "6 of 4 frames",
        "processor: ",
        "| rmse | ",
        "| a | b |",
    ):
        assert told in card, told


@pytest.mark.slow
def test_the_card_tells_of_the_training_before(run: Path, tmp_path: Path) -> None:
    pack = run.parent / "pack"
    taken = []
    for name, weights in (("second", run), ("third", tmp_path / "second")):
        taken.append(json.loads((weights / "best.json").read_text())["step"])
        asked = wishes("dfnet", pack, weights=weights / "best.safetensors", geometry="on")
        trained(asked, tmp_path / name)
    card = export_weights(tmp_path / "third", tmp_path / "out").with_suffix(".md").read_text()
    rows = [line for line in card.splitlines() if line.startswith("| before that |")]
    assert rows == [
        f"| before that | {taken[0]} of 6 steps of 4 frames of 9 at 32x32, rate 0.001 |",
        f"| before that | {taken[1]} of 6 steps of 4 frames of 9 at 32x32, "
        "turned, mirrored and enlarged, rate 0.001 |",
    ]
    assert "| augmented | frames turned, mirrored and enlarged" in card


def test_what_half_precision_cannot_hold_stays(tmp_path: Path) -> None:
    large = torch.tensor([1e6, 1.0])
    tiny = torch.tensor([1e-9, 1.0])
    whole = torch.tensor([3, 4])
    assert half(large, "a", tmp_path).dtype == torch.float32
    assert half(tiny, "a", tmp_path).dtype == torch.float32
    assert half(whole, "a", tmp_path).dtype == torch.int64
    with pytest.raises(ToolkitError, match="not finite"):
        half(torch.tensor([float("nan")]), "a", tmp_path)


def test_damaged_weights_are_not_given_away(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "run")
    weights = tmp_path / "run" / "best.safetensors"
    data = bytearray(weights.read_bytes())
    data[-400:] = bytes(400)  # zeros, as after a crash of the machine: still a file of weights
    weights.write_bytes(data)
    with pytest.raises(ToolkitError, match=r"best\.safetensors: was changed or damaged since best"):
        export_weights(tmp_path / "run", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    asked = wishes("dfnet", run.parent / "pack", weights=weights)
    with pytest.raises(ToolkitError, match="was changed or damaged since"):
        trained(asked, tmp_path / "next")
    # A training of an earlier version knows no digest.
    scores = tmp_path / "run" / "best.json"
    document = json.loads(scores.read_text())
    del document["weights"]
    scores.write_text(json.dumps(document))
    assert export_weights(tmp_path / "run", tmp_path / "out").is_file()


def test_a_training_without_weights_is_refused(run: Path, tmp_path: Path) -> None:
    (tmp_path / "config.json").write_bytes((run / "config.json").read_bytes())
    with pytest.raises(ToolkitError, match="no weights yet"):
        export_weights(tmp_path, tmp_path / "out")
    save_file({"a": torch.zeros(1)}, tmp_path / "best.safetensors")
    with pytest.raises(ToolkitError, match="cannot read the document"):
        export_weights(tmp_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("field", ["method", "preset"])
@pytest.mark.parametrize("value", ["../../outside/evil", "/tmp/evil", "a/b", "", "a\0b"])
def test_a_name_that_leads_out_is_refused(
    run: Path, tmp_path: Path, field: str, value: str
) -> None:
    shutil.copytree(run, tmp_path / "run")
    config = tmp_path / "run" / "config.json"
    config.write_text(json.dumps(json.loads(config.read_text()) | {field: value}))
    with pytest.raises(ToolkitError, match=rf"config\.json: {field}: is no name"):
        export_weights(tmp_path / "run", tmp_path / "x" / "out")
    assert not (tmp_path / "x").exists()


def test_weights_of_a_file_of_the_user_are_named_without_its_path(
    run: Path, tmp_path: Path
) -> None:
    shutil.copytree(run, tmp_path / "run")
    config = tmp_path / "run" / "config.json"
    method = {"method": "../my methods.py:Net"}
    config.write_text(json.dumps(json.loads(config.read_text()) | method))
    assert export_weights(tmp_path / "run", tmp_path / "out").name == "Net-compact.safetensors"
    assert {p.parent for p in tmp_path.rglob("Net*")} == {tmp_path / "out"}


def test_a_card_of_the_user_is_not_replaced(run: Path, tmp_path: Path) -> None:
    card = tmp_path / "dfnet-compact.md"
    card.write_text("mine")
    with pytest.raises(ToolkitError, match=r"dfnet-compact\.md: is not a file of this command"):
        export_weights(run, tmp_path)
    assert card.read_text() == "mine"
    card.unlink()
    export_weights(run, tmp_path)
    export_weights(run, tmp_path)  # its own files are
    card.write_text("changed")
    with pytest.raises(ToolkitError, match="was changed since it was written"):
        export_weights(run, tmp_path)


@pytest.mark.parametrize("name", ["config.json", "run.json", "best.json", "steps.csv"])
def test_a_damaged_training_is_one_line(run: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(run, tmp_path / "run")
    whole = (run / name).read_bytes()
    for text in (whole[: len(whole) // 2], b"{}", b"[]", b"null", b"\xff", b"step\n1e999\n"):
        (tmp_path / "run" / name).write_bytes(text)
        try:
            export_weights(tmp_path / "run", tmp_path / "out")
        except ToolkitError as error:
            assert name in str(error)
        else:  # the log may be short
            assert name == "steps.csv"


@pytest.mark.parametrize(
    ("field", "value"), [("learning_rate", 1e308), ("learning_rate", 0), ("batch_size", 10**12)]
)
def test_numbers_that_no_training_has_are_refused(
    run: Path, tmp_path: Path, field: str, value: float
) -> None:
    shutil.copytree(run, tmp_path / "run")
    config = json.loads((run / "config.json").read_text())
    config["optimization"][field] = value
    (tmp_path / "run" / "config.json").write_text(json.dumps(config))
    with pytest.raises(
        ToolkitError, match=rf"config\.json: optimization\.{field}: Expected .* [<>]"
    ):
        export_weights(tmp_path / "run", tmp_path / "out")
