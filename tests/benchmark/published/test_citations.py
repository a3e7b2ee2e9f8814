"""citations.bib: its entries are whole, its names exist, and runs find theirs."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from benchmark.data.splits import splits
from benchmark.methods.registry import grasp_planners, pose_methods, restorers
from benchmark.metrics.protocols.protocol import protocols
from benchmark.published.citations import KEYS, citations, entries, names_of_runs
from std_toolkit.errors import ToolkitError


def test_every_entry_is_used_and_whole() -> None:
    assert set(entries()) == {key for keys in KEYS.values() for key in keys}
    for key, entry in entries().items():
        assert entry.count("{") == entry.count("}"), key
        fields = dict(re.findall(r"^  (\w+) = \{(.*)\},?$", entry, re.M))
        assert {"author", "title", "year"} < set(fields), key
        assert re.fullmatch(r"20\d\d|199\d", fields["year"])
        assert fields["year"] in key


def test_every_name_is_one_of_the_command_line() -> None:
    known = {
        *restorers.names(),
        *pose_methods.names(),
        *grasp_planners.names(),
        *splits.names(),
        *protocols.names(),
        "bop",
    }
    assert set(KEYS) <= known
    # What has no paper is chosen, not forgotten.
    own = {"raw", "nearest", "planes", "onnx", "scenes", "std-export", "strict", "gt-nocs"}
    assert known - set(KEYS) <= own | {
        *("antipodal", "full-frame", "aligned-frame", "aligned-clip")
    }


def test_a_source_is_cited_once() -> None:
    text = citations(["swindrnet", "std-catknown", "paper", "nlspn", "nearest", "x.py:Mine"])
    assert re.findall(r"^@\w+\{(.+),", text, re.M) == [
        "std_toolkit",
        "dai2022dreds",
        "park2020nlspn",
    ]
    assert "% swindrnet, std-catknown, paper\n" in text


def test_names_of_runs(tmp_path: Path) -> None:
    (tmp_path / "a/b").mkdir(parents=True)
    setup = {"method": "nlspn", "split": "dreds-catnovel", "protocol": "paper", "size": [1, 2]}
    (tmp_path / "a/b/run.json").write_text(json.dumps({"setup": setup}))
    (tmp_path / "a/bop.json").write_text("{}")
    found = names_of_runs([tmp_path], ["run.json", "bop.json"])
    assert found == ["nlspn", "dreds-catnovel", "paper", "bop"]
    (tmp_path / "a/bop.json").write_text("[]")
    with pytest.raises(ToolkitError, match=r"bop\.json"):
        names_of_runs([tmp_path], ["bop.json"])
