"""Checks of `make docs` that need no site: code, options, docstrings, links; the README."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from tools import check_docs
from tools.make_dist import index_project, index_readme

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.mark.slow
def test_every_option_of_the_guides_exists() -> None:
    assert list(check_docs.check_commands()) == []


@pytest.mark.slow
def test_every_public_name_has_a_docstring() -> None:
    assert list(check_docs.check_docstrings()) == []


@pytest.mark.long
def test_every_python_block_runs() -> None:
    assert list(check_docs.check_python()) == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("```python\nprint(\n```\n", "never closed"),
        ("```python\nfrom std_toolkit import Nothing\n```\n", "no Nothing"),
        ("```python\nimport std_toolkit\nraise KeyError('x')\n```\n", "KeyError"),
        ("```python\nnowhere\n```\n", "NameError"),
    ],
)
def test_a_block_that_does_not_run_is_found(
    text: str, problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "page.md"
    page.write_text(text)
    monkeypatch.setattr(check_docs, "PAGES", (page,))
    monkeypatch.setattr(check_docs, "ROOT", tmp_path)
    found = list(check_docs.check_python())
    assert found and problem in " ".join(found)


def test_a_wrong_option_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "```bash\nstd-restore rec --nothing 3 --out x   # note\nstd-curate info s --frames\n```\n"
    )
    monkeypatch.setattr(check_docs, "PAGES", (page,))
    monkeypatch.setattr(check_docs, "ROOT", tmp_path)
    (found,) = check_docs.check_commands()
    assert "no --nothing" in found


def test_every_page_is_in_the_navigation_and_every_link_leads_somewhere() -> None:
    text = (REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8")
    nav = str(yaml.safe_load(text)["nav"])
    for page in sorted((REPOSITORY / "docs").glob("*.md")):
        assert f"'{page.name}'" in nav, page.name
    pages = [*(REPOSITORY / "docs").glob("*.md"), REPOSITORY / "README.md"]
    for page in pages:
        links = re.findall(r"\]\(([^)\s#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
        for link in links:
            if not re.match(r"[a-z]+:", link):
                assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_links_of_an_index_page_are_absolute() -> None:
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    for repository in ("https://example.org/a/b", ""):
        made = index_readme(text, repository)
        links = re.findall(r"\]\(([^)\s]+)\)", made)
        assert [link for link in links if not re.match(r"https://|#", link)] == []
        assert ("first_screen.jpg" in made) == bool(repository)
    project = (REPOSITORY / "pyproject.toml").read_text(encoding="utf-8")
    assert index_project(project, "") == project
    assert 'Issues = "https://example.org/a/b/issues"' in index_project(
        project, "https://example.org/a/b"
    )


def test_citation_file_is_of_this_version() -> None:
    import std_toolkit

    cff = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert cff["version"] == std_toolkit.__version__
    assert cff["license"] == "Apache-2.0" and cff["cff-version"] == "1.2.0"
