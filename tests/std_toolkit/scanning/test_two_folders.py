"""The command line of two folders of photos."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("numba")
pytest.importorskip("manifold3d")

from std_toolkit.cli.scanning import main


@pytest.fixture(autouse=True)
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("photos", "over"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path)


def test_the_second_word_is_the_flipped_object(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["photos/", "over/", "--revolve", "--out", "cup"]) != 0
    assert "takes one folder of photos" in capsys.readouterr().err
    assert main(["photos/", "photos", "--out", "cup"]) != 0
    assert "the second folder is the first" in capsys.readouterr().err
    assert main(["photos/", "over/", "--out", "cup"]) != 0
    assert "0 photos are too few" in capsys.readouterr().err


def test_a_folder_with_the_name_of_the_command_is_not_left_out(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["photos", "over", "--out", "cup"]) != 0
    assert "write ./photos" in capsys.readouterr().err
