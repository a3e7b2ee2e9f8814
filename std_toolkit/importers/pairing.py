"""Finding the images of a recording and pairing colour with depth by name."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger
from std_toolkit.scene.document import safe_name

# Words that tell what an image shows, not which frame it is.
_ROLE_WORDS = (
    "color", "colour", "rgb", "image", "img", "depth", "aligned", "raw", "left", "z", "d",
)  # fmt: skip
_COLOR_WORDS = frozenset({"color", "colour", "rgb"})
_DEPTH_WORDS = frozenset({"depth"})
_SEPARATORS = re.compile(r"[-_. ]+")


def natural_key(text: str) -> tuple[tuple[int, int | str], ...]:
    """Sort key that orders numbers inside names by value: 2 before 10."""
    parts = re.split(r"(\d+)", text)
    return tuple((0, int(p)) if p.isdigit() else (1, p) for p in parts if p)


def frame_key(stem: str) -> str:
    """The part of a file's stem that names the frame: "0007-color" and "depth_0007" give "0007"."""
    pieces = re.split(r"([-_. ]+)", stem)
    words, gaps = pieces[0::2], pieces[1::2]
    keep = [i for i, w in enumerate(words) if w and w.lower() not in _ROLE_WORDS]
    if not keep:
        return stem
    key = words[keep[0]]
    for before, i in pairwise(keep):
        key += (gaps[before] if i == before + 1 else gaps[i - 1]) + words[i]
    return key


def list_images(
    where: str, suffixes: tuple[str, ...], *, role: str, shared: bool = False
) -> dict[str, Path]:
    """Images of a folder or glob pattern, by frame key, in natural order.

    Args:
        where: folder, or a pattern such as "rec/*-color.png".
        suffixes: accepted file suffixes, lower case.
        role: "color" or "depth".
        shared: colour and depth lie in one folder: take only names that hold the role's word.

    Raises:
        ToolkitError: no such folder, no images in it, or two images of one frame.
    """
    folder = Path(where)
    if any(c in where for c in "*?["):
        parent, pattern = folder.parent, folder.name
        paths = [p for p in _listed(parent, role) if p.match(pattern)]
    else:
        paths = _listed(folder, role)
    paths = [p for p in paths if p.suffix.lower() in suffixes and not p.name.startswith(".")]
    # Masks and previews next to the images have no place in a recording; only a shared folder
    # makes the role word necessary.
    if shared:
        wanted = _COLOR_WORDS if role == "color" else _DEPTH_WORDS
        paths = [p for p in paths if wanted & {w.lower() for w in _SEPARATORS.split(p.stem)}]
    if not paths:
        raise ToolkitError(
            f"no {role} images here", path=where, hint=f"files end in {', '.join(suffixes)}"
        )
    found: dict[str, Path] = {}
    for path in sorted(paths, key=lambda p: natural_key(p.stem)):
        key = frame_key(path.stem)
        if key in found:
            raise ToolkitError(
                f"two {role} images of one frame: {found[key].name} and {path.name}",
                path=path.parent,
                value=key,
                hint='choose one kind with a pattern, such as --color "DIR/*-color.png"',
            )
        found[key] = path
    return found


def _listed(folder: Path, role: str) -> list[Path]:
    if folder.is_file():
        raise ToolkitError(
            f"a file, not a folder of {role} images",
            path=folder,
            hint=f'give its folder, or a pattern such as --{role} "DIR/*{folder.suffix}"',
        )
    if not folder.is_dir():
        raise ToolkitError(f"no such folder of {role} images", path=folder)
    return [p for p in folder.iterdir() if p.is_file()]


def pair(
    color: dict[str, Path], depth: dict[str, Path], *, skip_unpaired: bool = False
) -> dict[str, Path]:
    """Depth path of every colour key.

    Raises:
        ToolkitError: a frame lacks its colour or its depth (unless `skip_unpaired`).
    """
    no_depth = [k for k in color if k not in depth]
    no_color = [k for k in depth if k not in color]
    if (no_depth or no_color) and not skip_unpaired:
        problems = [
            f"{len(keys)} without {what}: {', '.join(keys[:5])}{' ...' if len(keys) > 5 else ''}"
            for keys, what in ((no_depth, "depth"), (no_color, "colour"))
            if keys
        ]
        raise ToolkitError(
            "colour and depth do not pair by name: " + "; ".join(problems),
            path=next(iter(depth.values())).parent,
            hint="mend the names, or give --skip-unpaired to leave these frames out",
        )
    paired = {k: depth[k] for k in color if k in depth}
    if not paired:
        raise ToolkitError(
            "no colour image has a depth image of the same name",
            path=next(iter(color.values())).parent,
        )
    if no_depth or no_color:
        logger.warning("left out %d frames without a partner", len(no_depth) + len(no_color))
    return paired


def frame_names(keys: list[str]) -> dict[str, str]:
    """Safe, unique frame name of every key.

    Raises:
        ToolkitError: two keys become the same safe name.
    """
    names: dict[str, str] = {}
    seen: dict[str, str] = {}
    for key in keys:
        name = safe_name(key)
        if name in seen:
            raise ToolkitError(f"frames {seen[name]!r} and {key!r} become one name", value=name)
        seen[name] = key
        names[key] = name
    return names


def warn_about_gaps(keys: list[str]) -> None:
    """Warn where a numbered sequence has holes (dropped or deleted frames)."""
    numbers = [int(m.group(1)) for k in keys if (m := re.search(r"(\d{1,12})$", k))]
    if len(numbers) != len(keys) or len(numbers) < 3:
        return
    steps = [b - a for a, b in pairwise(numbers)]
    usual = sorted(steps)[len(steps) // 2]
    gaps = [i for i, s in enumerate(steps) if s > usual > 0]
    if gaps and usual > 0 and len(gaps) <= len(steps) // 4:
        where = ", ".join(keys[i] for i in gaps[:5])
        logger.warning("frames are missing after %s%s", where, " ..." if len(gaps) > 5 else "")
