"""A training that is interrupted anywhere ends as if it had not been."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from training_set import HERE, LARGE, TINY, packed, same, trained, wishes, write_scenes

from benchmark.training.run_files import CHECKPOINT, is_trained
from std_toolkit.cli.command import exit_status
from std_toolkit.errors import ToolkitError


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("resume")
    return packed(top / "pack", write_scenes(top / "data"))


class Interrupted(Exception):
    pass


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "at"),
    [
        *(pytest.param(m, 3, marks=pytest.mark.long if m in LARGE else []) for m in TINY),
        # What lies between two checkpoints is the same for every network.
        *(pytest.param(m, 4, marks=[] if m == "dfnet" else pytest.mark.long) for m in TINY),
    ],
)
def test_interrupted_and_resumed_ends_with_the_same_bits(method, at, pack, tmp_path, monkeypatch):
    """Step 3 stands between two checkpoints, step 4 right behind one and before its validation."""
    from benchmark.training.module import RestorerTraining

    asked = wishes(
        method,
        pack,
        colors="on",
        object_dropout=0.5,
        copy_paste=0.5,
        clear_gone=0.4,
        clear_behind=0.4,
        holes=0.5,
        wrong_color=0.3,
        accumulate=2,
        batch_norm="recomputed",
    )
    whole = trained(asked, tmp_path / "whole")

    plain = RestorerTraining.training_step

    def falls(self, batch, batch_idx):
        if self.global_step == at:
            raise Interrupted
        return plain(self, batch, batch_idx)

    with monkeypatch.context() as patch:
        patch.setattr(RestorerTraining, "training_step", falls)
        with pytest.raises(Interrupted):
            trained(asked, tmp_path / "parted")
    assert not (tmp_path / "parted" / "last.safetensors").exists()
    parted = trained(asked, tmp_path / "parted")
    assert same(whole, parted)
    for name in ("validation.csv", "best.json"):
        one, other = (tmp_path / run / name for run in ("whole", "parted"))
        assert one.read_text() == other.read_text(), name
    assert _losses(tmp_path / "whole") == _losses(tmp_path / "parted")
    assert [step for step, _ in _losses(tmp_path / "whole")] == [str(i) for i in range(1, 7)]


@pytest.mark.slow
def test_interrupted_while_the_checkpoint_is_written(pack, tmp_path, monkeypatch):
    asked = wishes("dfnet", pack)
    whole = trained(asked, tmp_path / "whole")
    save, calls = torch.save, []

    def half(value, path):
        calls.append(path)
        if len(calls) == 2:
            Path(path).write_bytes(b"PK half a checkpoint")
            os._exit(9)
        save(value, path)

    child = os.fork()
    if child == 0:
        try:
            torch.save = half
            trained(asked, tmp_path / "parted")
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    left = [p.name for p in (tmp_path / "parted").iterdir() if ".tmp" in p.name]
    assert left, "the half-written file is still there"
    assert same(whole, trained(asked, tmp_path / "parted"))
    assert not [p for p in (tmp_path / "parted").iterdir() if ".tmp" in p.name]


@pytest.mark.slow
def test_killed_at_any_moment(pack, tmp_path):
    """kill -9 of the command, twice, right after some checkpoint."""
    asked = wishes("dfnet", pack, steps=120, validate_every=20)
    whole = trained(asked, tmp_path / "whole")
    settings = [f"{name}={value}" for name, value in TINY["dfnet"].items()]
    command = [
        sys.executable, "-m", "benchmark.cli.train", "--method", "dfnet", "--data", str(pack),
        "--set", *settings, "--steps", "120", "--batch-size", "4", "--hold-out", "0.3",
        "--checkpoint-every", "2", "--validate-every", "20", "--readers", "1",
        "--accelerator", "cpu", "--out", str(tmp_path / "parted"),
    ]  # fmt: skip
    checkpoint = tmp_path / "parted" / CHECKPOINT
    for attempt in range(2):
        said = tmp_path / f"said-{attempt}.txt"
        before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        with said.open("wb") as file:
            process = subprocess.Popen(
                command,
                env=os.environ | {"OMP_NUM_THREADS": "1"},
                stdout=file,
                stderr=file,
            )
        while process.poll() is None:
            time.sleep(0.005)
            if checkpoint.exists() and checkpoint.stat().st_mtime_ns != before:
                # Its readers live on for a while.
                process.kill()
                break
        assert process.wait() == -signal.SIGKILL, said.read_text()[-2000:]
    assert not (tmp_path / "parted" / "last.safetensors").exists()
    assert same(whole, trained(asked, tmp_path / "parted"))
    assert _losses(tmp_path / "whole")[-1] == _losses(tmp_path / "parted")[-1]


@pytest.mark.slow
def test_a_finished_training_stays_as_it_is(pack, tmp_path):
    asked = wishes("dfnet", pack)
    first = trained(asked, tmp_path / "run")
    log = (tmp_path / "run" / "steps.csv").read_text()
    assert same(first, trained(asked, tmp_path / "run"))
    assert (tmp_path / "run" / "steps.csv").read_text() == log


@pytest.mark.slow
def test_another_configuration_is_refused_with_all_that_differs(pack, tmp_path):
    trained(wishes("dfnet", pack, steps=1), tmp_path / "run")
    other = wishes("dfnet", pack, steps=1, seed=1, learning_rate=0.5, loss={"smoothness": "0.2"})
    with pytest.raises(ToolkitError) as error:
        trained(other, tmp_path / "run")
    told = str(error.value)
    for part in (
        "seed: 0 then, 1 now",
        "optimization.learning_rate: this training was begun with 0.001 (got 0.5)",
        "loss.smoothness: None then, '0.2' now",
    ):
        assert part in told
    assert "optimization.betas" not in told


def test_other_frames_are_another_configuration(pack, tmp_path):
    trained(wishes("dfnet", pack, steps=1), tmp_path / "run")
    more = packed(tmp_path / "more", write_scenes(tmp_path / "data", scenes=5))
    with pytest.raises(ToolkitError, match=r"training: .* then, .* now"):
        trained(wishes("dfnet", more, steps=1), tmp_path / "run")


def test_a_folder_of_something_else_is_left_alone(pack, tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(ToolkitError, match=r"contains files but no config\.json"):
        trained(wishes("dfnet", pack, steps=1), tmp_path)


def test_files_that_changed_are_told_or_made_again(pack, tmp_path):
    asked, run = wishes("dfnet", pack, steps=2), tmp_path / "run"
    whole = trained(asked, run)
    last, checkpoint, best = (run / n for n in ("last.safetensors", CHECKPOINT, "best.safetensors"))
    assert is_trained(run)
    damaged = bytearray(last.read_bytes())
    damaged[-400:] = bytes(400)  # a header that promises the same tensors
    last.unlink()  # `whole` is mapped from it
    last.write_bytes(damaged)
    assert not is_trained(run)
    assert same(whole, trained(asked, run)) and is_trained(run)
    for path in (best, checkpoint):
        data = path.read_bytes()
        path.unlink()
        path.write_bytes(data[:-400] + bytes(400))
        with pytest.raises(ToolkitError, match=f"{path.name}.*changed or damaged"):
            trained(asked, run)
        path.write_bytes(data)
    (run / "digests.json").unlink()  # as in trainings of 0.1.0
    assert same(whole, trained(asked, run))
    checkpoint.write_bytes(b"PK nonsense")
    (run / "digests.json").unlink()
    with pytest.raises(ToolkitError, match="not a checkpoint of std-train"):
        trained(asked, run)


@pytest.mark.slow
def test_not_a_number_stops_before_it_harms(pack, tmp_path, monkeypatch):
    from benchmark.training.module import RestorerTraining

    asked = wishes("nlspn", pack)
    step = RestorerTraining.training_step
    poisoned: list[str] = []

    def poison(self, batch, batch_idx):
        if self.global_step == 3:
            batch["raw"][1] = float("nan")
            poisoned.append(self.key(int(batch["index"][1])))
        return step(self, batch, batch_idx)

    monkeypatch.setattr(RestorerTraining, "training_step", poison)
    with pytest.raises(ToolkitError, match="not a number at step 3") as error:
        trained(asked, tmp_path / "run")
    assert poisoned[0] in str(error.value)
    kept = torch.load(tmp_path / "run" / CHECKPOINT, weights_only=True)
    assert kept["global_step"] == 2
    assert all(torch.isfinite(t).all() for t in kept["state_dict"].values())
    monkeypatch.undo()
    assert same(trained(asked, tmp_path / "run"), trained(asked, tmp_path / "whole"))


def test_gradients_that_are_not_numbers_stop_too(pack, tmp_path, monkeypatch):
    from benchmark.training.callbacks import Watch

    def spoil(self, trainer, pl_module, loss):
        next(pl_module.parameters()).register_hook(lambda g: g * float("nan"))

    monkeypatch.setattr(Watch, "on_before_backward", spoil)
    with pytest.raises(ToolkitError, match="gradients are not numbers at step 0, frames pack: "):
        trained(wishes("dfnet", pack), tmp_path / "run")


def test_one_training_per_folder(pack, tmp_path):
    from std_toolkit.io.locks import hold_lock

    (tmp_path / "run").mkdir()
    with (
        hold_lock(tmp_path / "run", "lock", doing="training in"),
        pytest.raises(ToolkitError, match="another process is training in this folder"),
    ):
        trained(wishes("dfnet", pack), tmp_path / "run")


@pytest.mark.slow
def test_readers_change_nothing(pack, tmp_path):
    asked = wishes("dfnet", pack, steps=4)
    one = trained(asked, tmp_path / "one")
    assert same(one, trained(asked, tmp_path / "two", replace(HERE, readers=2)))


def _losses(run: Path) -> list[tuple[str, str]]:
    import csv

    with (run / "steps.csv").open(newline="") as file:
        return [(row["step"], row["loss"]) for row in csv.DictReader(file)]


FULL = {
    "validation.csv": "benchmark.training.run_files:Rows.save",
    "best.safetensors": "benchmark.training.callbacks:save_weights",
    "best.json": "benchmark.training.callbacks:write_document",
    "step-0000004.jpg": "benchmark.training.validation:DepthValidator.gallery",
    "last.safetensors": "benchmark.training.fit:save_weights",
    "tensorboard": "benchmark.training.callbacks:Watch._show",
}


@pytest.mark.slow
@pytest.mark.parametrize("what", FULL)
def test_a_full_disk_is_one_line_whatever_is_written(what, pack, tmp_path):
    """From when this is to be written behind step 4, nothing can be any more."""
    run, asked = tmp_path / "run", wishes("dfnet", pack)
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.dup2(writing, 2)
            sys.stderr = os.fdopen(2, "w", buffering=1)
            _fill_the_disk(FULL[what], {"validation.csv": 1, "tensorboard": 2}.get(what, 0))
            os._exit(exit_status(lambda: bool(trained(asked, run)), program="std-train"))
        finally:
            os._exit(9)
    os.close(writing)
    with os.fdopen(reading) as stream:
        said = stream.read()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1, said
    errors = [line for line in said.splitlines() if line.startswith("error")]
    assert len(errors) == 1 and "Traceback" not in said
    assert str(run) in errors[0] and what in errors[0] and "cannot write" in errors[0]
    step = torch.load(run / CHECKPOINT, weights_only=True)["global_step"]
    assert step == (6 if what == "last.safetensors" else 2)
    assert not [p for p in run.rglob("*") if ".tmp" in p.name]
    assert same(trained(asked, run), trained(asked, tmp_path / "whole"))


def _fill_the_disk(where: str, after: int) -> None:
    """A limit on the size of files, set when a function is called for another time."""
    import importlib
    import resource

    module, _, name = where.partition(":")
    owner, _, attribute = name.rpartition(".")
    holder = importlib.import_module(module)
    holder = getattr(holder, owner) if owner else holder
    plain, calls = getattr(holder, attribute), []

    def fills(*args, **options):
        calls.append(1)
        if len(calls) > after:
            resource.setrlimit(resource.RLIMIT_FSIZE, (20, resource.RLIM_INFINITY))
            try:
                return plain(*args, **options)
            finally:
                time.sleep(0.3)  # TensorBoard writes in a thread
        return plain(*args, **options)

    setattr(holder, attribute, fills)


@pytest.mark.slow
def test_a_full_disk_leaves_the_last_checkpoint(pack, tmp_path):
    """The limit on the size of files stands for the disk's: writing fails half-way for real."""
    import resource

    from benchmark.training.trainer import AtomicCheckpoints

    asked = wishes("dfnet", pack, steps=4)
    trained(asked, tmp_path / "whole")
    size = (tmp_path / "whole" / CHECKPOINT).stat().st_size
    run, save = tmp_path / "run", AtomicCheckpoints.save_checkpoint
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fills(self, checkpoint, path, storage_options=None):
        if (run / CHECKPOINT).exists():
            resource.setrlimit(resource.RLIMIT_FSIZE, (size // 2, hard))
        save(self, checkpoint, path, storage_options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(AtomicCheckpoints, "save_checkpoint", fills)
        try:
            with pytest.raises(ToolkitError, match="cannot write the") as error:
                trained(asked, run)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert str(run / CHECKPOINT) in str(error.value)
    assert torch.load(run / CHECKPOINT, weights_only=True)["global_step"] == 2
    assert not [p for p in run.iterdir() if ".tmp" in p.name]
    assert same(trained(asked, run), trained(asked, tmp_path / "whole"))
