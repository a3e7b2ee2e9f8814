"""Downloads happen on demand only, and only with the right checksum."""

from __future__ import annotations

import hashlib
from pathlib import Path

import msgspec
import pytest

from sensors.assets.downloads import Download, DownloadList, fetch, load_list
from sensors.simulation.cli import main
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import write_document


def listed(path: Path, content: bytes) -> Download:
    return Download(
        name="a.hdr",
        folder="environments",
        url=path.as_uri(),
        bytes=len(content),
        sha256=hashlib.sha256(content).hexdigest(),
        licence="CC0-1.0",
        page="https://example.org",
    )


def test_a_file_is_fetched_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "source"
    source.write_bytes(b"light")
    file = tmp_path / "list.json"
    write_document(file, DownloadList(assets=[listed(source, b"light")]))
    words = ["assets", "fetch", "--out", str(tmp_path / "out"), "--list-file", str(file)]
    assert main(words) == 0 and "1 files downloaded" in capsys.readouterr().out
    assert (tmp_path / "out/environments/a.hdr").read_bytes() == b"light"
    source.unlink()
    assert main(words) == 0 and "0 files downloaded" in capsys.readouterr().out


def test_another_content_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.write_bytes(b"dark!")
    with pytest.raises(ToolkitError, match="another content"):
        fetch(tmp_path / "out", [listed(source, b"light")])
    assert not (tmp_path / "out").exists()
    source.unlink()
    with pytest.raises(ToolkitError, match=r"a\.hdr: cannot be downloaded"):
        fetch(tmp_path / "out", [listed(source, b"light")])


def test_the_built_in_list_is_free_and_safe(capsys: pytest.CaptureFixture[str]) -> None:
    found = load_list()
    assert all(item.licence == "CC0-1.0" and item.url.startswith("https://") for item in found)
    assert main(["assets", "list"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(found)
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({**msgspec.to_builtins(found[0]), "name": "../x"}, Download)
