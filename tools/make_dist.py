#!/usr/bin/env python3
"""Build wheel and source distribution: `python tools/make_dist.py [--out DIR]`.

Relative links of README.md lead nowhere on the page of a package index. They become absolute with
`repository` of `[tool.std-toolkit]` in pyproject.toml, the address of the repository's pages, which
also gives the project URLs. While it is empty, README.md of the distribution has their text alone,
and no pictures.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
_PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
_LINK = re.compile(r"(?<!!)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
_ABSOLUTE = re.compile(r"[a-z]+:|#")


def index_readme(text: str, repository: str) -> str:
    """README.md for a package index.

    Args:
        repository: address such as https://github.com/OWNER/NAME; empty if there is none.

    >>> index_readme("see [x](docs/x.md), ![y](docs/y.jpg)", "https://example.org/a/b")
    'see [x](https://example.org/a/b/blob/main/docs/x.md), ![y](https://example.org/a/b/raw/main/docs/y.jpg)'
    >>> index_readme("see [x](docs/x.md)", "")
    'see x'
    """

    def picture(match: re.Match[str]) -> str:
        title, target = match.groups()
        if _ABSOLUTE.match(target):
            return match.group()
        return f"![{title}]({repository}/raw/main/{target})" if repository else ""

    def link(match: re.Match[str]) -> str:
        title, target = match.groups()
        if _ABSOLUTE.match(target):
            return match.group()
        return f"[{title}]({repository}/blob/main/{target})" if repository else title

    return _LINK.sub(link, _PICTURE.sub(picture, text))


def index_project(text: str, repository: str) -> str:
    """pyproject.toml with the project URLs."""
    if not repository:
        return text
    urls = {
        "Homepage": repository,
        "Documentation": f"{repository}/tree/main/docs",
        "Changelog": f"{repository}/blob/main/CHANGELOG.md",
        "Issues": f"{repository}/issues",
    }
    table = "\n".join(f'{name} = "{url}"' for name, url in urls.items())
    return text.replace("[project.scripts]", f"[project.urls]\n{table}\n\n[project.scripts]")


def tracked_files() -> list[str]:
    """Files of the repository as they are in the working folder, without ignored ones."""
    words = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    listed = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def build(out: Path) -> None:
    """Build both distributions from a copy of the repository.

    Raises:
        subprocess.CalledProcessError: the build fails.
    """
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    repository = tomllib.loads(project)["tool"]["std-toolkit"]["repository"].rstrip("/")
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "std-toolkit"
        for name in tracked_files():
            target = copy / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, target)
        readme = (ROOT / "README.md").read_text(encoding="utf-8")
        (copy / "README.md").write_text(index_readme(readme, repository), encoding="utf-8")
        (copy / "pyproject.toml").write_text(index_project(project, repository), encoding="utf-8")
        uv = shutil.which("uv", path=f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin")
        command = [uv, "build"] if uv else [sys.executable, "-m", "build"]
        subprocess.run([*command, "--outdir" if not uv else "-o", str(out), str(copy)], check=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build/dist")
    build(parser.parse_args().out.absolute())
