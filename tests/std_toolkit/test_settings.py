"""Limits: groups, files, overrides, worker processes, and what is recorded of them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

from std_toolkit.cli.command import read_settings
from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.labels.texture.comparison import TextureSettings
from std_toolkit.options import Share
from std_toolkit.settings import (
    Settings,
    changed,
    every_group,
    limit,
    override,
    settings_text,
)


@dataclass(frozen=True, kw_only=True)
class Ranged(Settings):
    """A limit with a range."""

    share: Share = limit(0.5, source="made up")  # noqa: RUF009
    """smallest share that is accepted"""


def clarity(_: int) -> float:
    return TextureSettings.current().clarity


def test_a_file_changes_a_limit(tmp_path: Path) -> None:
    file = tmp_path / "limits.toml"
    file.write_text("[labels.texture.comparison]\nclarity = 0.25\n")
    before = TextureSettings.current()
    with override(*read_settings(file)):
        assert TextureSettings.current() == TextureSettings(clarity=0.25)
        assert changed() == {"labels.texture.comparison.clarity": 0.25}
    assert TextureSettings.current() == before
    assert changed() == {}


def test_a_refused_override_changes_nothing() -> None:
    with (
        pytest.raises(ToolkitError, match="at most 1"),
        override(TextureSettings(clarity=0.25), Ranged(share=2.0)),
    ):
        pass
    assert changed() == {}


def test_workers_have_the_same_limits() -> None:
    with override(TextureSettings(clarity=0.25)):
        report = run_jobs(clarity, [1, 2], name="limits", options=JobOptions(workers=2))
    assert set(report.results.values()) == {0.25}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[labels.texture.comparison]\nclearness = 1", "labels.texture.comparison.clearness"),
        ("[labels.texture.comparison]\nclarity = '1'", "expected a finite number"),
        ("[labels.texture.comparison]\nclarity = nan", "expected a finite number"),
        ("[labels.texture.comparison]\nclarity = true", "expected a finite number"),
        ("[labels.texture.comparison]\nclarity = -1", "at least 0"),
        ("[labels.support.evidence]\nfewest_points = inf", "expected a whole number"),
        ("[labels.support.evidence]\nfewest_points = 1.5", "expected a whole number"),
        ("[labels.texture.nothing]\nclarity = 1", "no group of settings"),
        ("[os]\nname = 1", "no group of settings"),
        ("clarity = 1", "no group of settings"),
        ("[[labels.texture.comparison]]\nclarity = 1", "comparison: expected a table"),
        ("labels.texture.comparison = 1", "comparison: expected a table"),
        (
            "[labels.texture.comparison]\nclarity = 1\n['labels.texture.comparison']\nclarity = 0",
            "the group is given twice",
        ),
        ("[labels.texture.comparison\n", "no TOML"),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "limits.toml"
    file.write_text(text)
    with pytest.raises(ToolkitError) as error:
        read_settings(file)
    assert words in str(error.value)
    assert str(file) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_command_refuses_a_wrong_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "limits.toml"
    file.write_text("[labels.texture.comparison]\nclearness = 1")
    assert main(["settings", "--settings", str(file)]) == 2
    assert "labels.texture.comparison.clearness" in capsys.readouterr().err


def test_the_printed_limits_can_be_read_again(tmp_path: Path) -> None:
    with override(TextureSettings(clarity=0.25)):
        text = settings_text(TextureSettings)
    assert tomllib.loads(text)["labels"]["texture"]["comparison"]["clarity"] == 0.25
    file = tmp_path / "limits.toml"
    file.write_text(text)
    assert read_settings(file) == (TextureSettings(clarity=0.25),)


@pytest.mark.slow
def test_every_limit_has_a_meaning_and_a_source() -> None:
    groups = every_group()
    assert TextureSettings in groups
    for kind in groups:
        for line in settings_text(kind).splitlines()[2::2]:
            meaning, _, source = line.partition(". Source: ")
            assert len(meaning) > 10, (kind.group, line)
            assert source, (kind.group, line)
