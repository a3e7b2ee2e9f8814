"""The command line of two folders of photos."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("manifold3d")

from std_toolkit.cli.scanning import main
from std_toolkit.io.images import write_color
from std_toolkit.poses.board_sheet import write_board_pdf


@pytest.fixture(autouse=True)
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("photos", "over"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path)


def test_the_second_word_is_the_flipped_object(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["photos/", "over/", "--revolve", "--out", "cup"]) != 0
    assert "takes one folder of photos" in capsys.readouterr().err
    assert main(["photos/", "photos", "--out", "cup"]) != 0
    told = capsys.readouterr().err
    assert "the second folder is the first" in told
    assert "PosixPath" not in told
    assert main(["photos/", "over/", "--out", "cup"]) != 0
    assert "0 photos are too few" in capsys.readouterr().err


def test_a_second_folder_that_is_missing_is_refused_before_the_first_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Grey photos have poses from no board: measuring the first would end with another message.
    for i in range(24):
        write_color(tmp_path / "photos" / f"{i:02d}.png", np.full((90, 120, 3), i, np.uint8))
    board = write_board_pdf(tmp_path / "board.pdf", paper="a4")[1]
    assert main(["photos/", "none", "--board", str(board), "--out", "cup"]) == 1
    told = capsys.readouterr().err
    assert "no such folder of photos" in told and "none" in told


def test_a_folder_with_the_name_of_the_command_is_not_left_out(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["photos", "over", "--out", "cup"]) != 0
    assert "write ./photos" in capsys.readouterr().err
