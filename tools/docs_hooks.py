"""Hooks of mkdocs: pages made from other files, links out of docs/, and the checks of code.

data_spec.md, CHANGELOG.md, the notebooks and the API reference become pages. Links to files outside
docs/ lead to the repository, if `repository` of `[tool.std-toolkit]` is set, or become plain text.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tools.check_docs import API, check_all  # noqa: E402

_LINK = re.compile(r"(?<!!)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(\.\./([^)\s]+)\)")
_OF_ROOT = re.compile(r"\]\((?!docs/|#|[a-z]+:)([^)\s]+)\)")
_PAGES = {"data_spec.md": "data_spec.md", "CHANGELOG.md": "changelog.md"}


def on_startup(**_: Any) -> None:
    """Find `tests` and `tools` in the repository.

    mkdocs takes back what a hook adds to `sys.path` while it is loaded; then `tests` would be that
    of a dependency.
    """
    sys.path.insert(0, str(ROOT))


def on_pre_build(config: Any) -> None:  # noqa: ARG001 (mkdocs passes it)
    """Fail where code does not run, an option does not exist or a docstring is missing."""
    problems = check_all()
    if problems:
        raise PluginError("\n".join(problems))


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages."""
    for name, page in _PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        # As if the page lay in docs/.
        text = _OF_ROOT.sub(r"](../\1)", text).replace("](docs/", "](")
        files.append(File.generated(config, page, content=text))
    for path in sorted((ROOT / "docs/notebooks").glob("*.ipynb")):
        files.append(
            File.generated(config, f"notebooks/{path.stem}.md", content=notebook_page(path))
        )
        files.remove(files.get_file_from_path(f"notebooks/{path.name}"))
    for page, (title, names) in API.items():
        files.append(File.generated(config, f"api/{page}.md", content=api_page(title, names)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Point links that leave docs/ to pages of the site or to the repository."""
    up = "../" * page.file.src_uri.count("/")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    repository = project["tool"]["std-toolkit"]["repository"].rstrip("/")

    def link(match: re.Match[str]) -> str:
        title, target = match.groups()
        name, hash_, anchor = target.partition("#")
        if name in _PAGES:
            return f"[{title}]({up}{_PAGES[name]}{hash_}{anchor})"
        if not (ROOT / name).exists():
            raise PluginError(f"{page.file.src_uri}: no such file: {target}")
        if name.startswith("docs/"):
            return f"[{title}]({up}{target.removeprefix('docs/')})"
        if repository:
            return f"[{title}]({repository}/blob/main/{target})"
        return title if name in title else f"{title} (`{name}`)"

    return _LINK.sub(link, markdown)


def notebook_page(path: Path) -> str:
    """The cells of a notebook as Markdown."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    parts = []
    for cell in cells:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    head, *rest = parts
    note = f"The notebook is `docs/notebooks/{path.name}`; the tests run it."
    return "\n\n".join([head, note, *rest])


def api_page(title: str, names: dict[str, list[str]]) -> str:
    """A page of the API reference."""
    parts = [f"# {title}"]
    for module, members in names.items():
        about = (import_module(module).__doc__ or "").splitlines()[0]
        parts.append(f"## `{module}`\n\n{about}")
        parts.extend(f"::: {defined_in(module, name)}" for name in members)
    return "\n\n".join(parts) + "\n"


def defined_in(module: str, name: str) -> str:
    """The full name of an object where it is defined, which lazy modules do not show."""
    value = getattr(import_module(module), name)
    home = getattr(value, "__module__", module)
    return f"{home if hasattr(value, '__qualname__') else module}.{name}"
