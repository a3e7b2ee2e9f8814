"""The guide docs/annotating.md and its reference agree with the program."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scene_on_disk import write_scene

from annotator.app.action_table import ACTIONS, key_table, with_key_table
from annotator.cli import main
from annotator.session import Session
from std_toolkit.scene import Scene

REPOSITORY = Path(__file__).parents[2]
GUIDE = REPOSITORY / "docs/annotating.md"
REFERENCE = REPOSITORY / "docs/annotating-reference.md"
TEXT = GUIDE.read_text(encoding="utf-8")
REFERENCE_TEXT = REFERENCE.read_text(encoding="utf-8")
PICTURES_KB = 1024


def block(mark: str) -> str:
    """The code block after a mark."""
    return TEXT.split(f"<!-- {mark} -->\n")[1].split("\n", 1)[1].split("```", 1)[0]


def test_its_keys_are_those_of_the_actions() -> None:
    assert with_key_table(REFERENCE_TEXT) == REFERENCE_TEXT, (
        "run: python -m annotator.app.action_table docs/annotating-reference.md"
    )
    for action in ACTIONS:
        for key in action.keys:
            assert f"`{key}`" in key_table()


def test_a_guide_without_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="no marks"):
        with_key_table("# A guide")


def test_keys_that_the_text_names_do_something() -> None:
    known = {key for action in ACTIONS for key in action.keys}
    prose = TEXT + REFERENCE_TEXT.split("## Keys and mouse")[0]
    named = set(
        re.findall(
            r"`((?:(?:Ctrl|Shift|Alt)\+)?(?:[A-Z0-9\[\]]|F\d|Pg\w+|Space|Home|Tab|Esc|Del|Return|Left|Right|Up|Down))`",
            prose,
        )
    )
    assert len(named) > 20
    assert named <= known


def test_its_links_and_pictures_are_there() -> None:
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", TEXT + REFERENCE_TEXT)
    missing = [link for link in links if not (GUIDE.parent / link).exists()]
    assert missing == []
    pictures = {GUIDE.parent / link for link in links if link.endswith(".jpg")}
    assert len(pictures) >= 4
    assert sum(p.stat().st_size for p in pictures) < PICTURES_KB * 1024


@pytest.mark.parametrize("source", [GUIDE, REFERENCE], ids=lambda path: path.stem)
def test_its_anchors_are_headings(source: Path) -> None:
    text = source.read_text(encoding="utf-8")
    for link, anchor in re.findall(r"\]\(([^)#]*)#([^)]+)\)", text):
        page = (source.parent / link).resolve() if link else source
        headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
        # As GitHub makes anchors: lower case, no punctuation, hyphens for spaces.
        anchors = [re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings]
        assert anchor in anchors, (link, anchor)


def test_the_script_runs(tmp_path: Path) -> None:
    root = write_scene(tmp_path / "scene").root
    trimesh.creation.cylinder(40.0, 95.0).export(tmp_path / "mug.obj")
    script = tmp_path / "edits.json"
    script.write_text(block("script"), encoding="utf-8")
    assert main([str(root), "--script", str(script), "--annotator", "mk"]) == 0
    scene = Scene.open(root)
    mug = next(o for o in scene.objects.objects if o.name == "mug")
    assert scene.objects.model(mug.model).diameter_m == pytest.approx(0.1242, abs=1e-3)
    with Session.open(root) as session:
        assert session.object("mug").status == "done"
        assert session.object("mug").note == "from a script"
        turned = session.pose("mug", 0)
    assert turned is not None
    assert np.trace(turned.R) != pytest.approx(1.0)


def test_the_python_example_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = write_scene(tmp_path / "scene").root
    with Session.open(root) as session:
        name = session.state.objects[0].name
        before = session.pose(name, 0)
    code = block("python").replace("scenes/table", str(root)).replace('"mug"', f'"{name}"')
    exec(compile(code, "docs/annotating.md", "exec"), {})
    assert name in capsys.readouterr().out
    with Session.open(root) as session:
        after = session.pose(name, 0)
    assert before is not None and after is not None
    assert after.flat() == before.flat()


def _told() -> list[str]:
    """All texts of the program, what is filled in replaced by {}."""
    texts = []
    for package in ("annotator", "std_toolkit"):
        for path in (REPOSITORY / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    texts.append(node.value)
                elif isinstance(node, ast.JoinedStr):
                    parts = [p.value if isinstance(p, ast.Constant) else "{}" for p in node.values]
                    texts.append("".join(str(p) for p in parts))
    return texts


@pytest.mark.slow
def test_the_messages_that_it_explains_are_those_of_the_program() -> None:
    rows = REFERENCE_TEXT.split("## Error messages")[1].split("##")[0].splitlines()
    quoted = [m for row in rows if (m := "".join(re.findall(r"^\| `([^`]+)`", row)))]
    assert len(quoted) > 10
    told = _told()
    told += [t.replace("{}", name, 1) for t in told for name in ("annotating", "a window")]
    told += [t.replace("{}", "scene", 1) for t in told if "{}" in t]
    assert [m for m in quoted if not any(m in text for text in told)] == []
