"""A folder of colour images, and one of aligned depth images, paired by name."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from std_toolkit import errors, log
from std_toolkit.importers.depth_files import DEPTH_SUFFIXES
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.importers.frame_cameras import frame_cameras
from std_toolkit.importers.importer import Recording, SourceFile, SourceFrame
from std_toolkit.importers.layouts import Layout, find_layout
from std_toolkit.importers.options import ImportRequest
from std_toolkit.importers.pairing import paired
from std_toolkit.io.images import COLOR_SUFFIXES, image_size
from std_toolkit.scene import Frame
from std_toolkit.scene.document import safe_name

# The unit of RealSense, Kinect and most data sets; `check_unit` detects other units.
DEFAULT_DEPTH_SCALE = 0.001

# Words that describe the content of an image, not the frame.
_ROLE_WORDS = (
    "color", "colour", "rgb", "image", "img", "depth", "aligned", "raw", "left", "z", "d",
)  # fmt: skip

_COLOR_WORDS = frozenset({"color", "colour", "rgb"})

_DEPTH_WORDS = frozenset({"depth"})

_SEPARATORS = re.compile(r"[-_. ]+")


class FolderImporter:
    """Separate images. Frames are sorted naturally; ids count from 0 in that order."""

    def recognises(self, source: Path) -> bool:
        """See `Importer`: one of the layouts that `layouts` knows."""
        return find_layout(source) is not None

    def read(self, request: ImportRequest) -> Recording:
        """See `Importer`.

        Raises:
            ToolkitError: images are missing or of different sizes, names do not pair, or the
                intrinsics do not fit.
        """
        layout = find_layout(request.source) if request.color is None else _layout_of(request)
        if layout is not None and request.color is None:
            request = _in_layout(request, layout)
        where = request.color or str(request.source)
        if request.intrinsics is None and request.known.cameras is None:
            raise errors.ToolkitError(
                "colour images need intrinsics",
                path=where,
                hint="give --intrinsics FILE or --intrinsics fx,fy,cx,cy",
            )
        shared = request.depth is not None and _same_folder(where, request.depth)
        color = list_images(where, COLOR_SUFFIXES, role="color", shared=shared)
        depth: dict[str, Path] = {}
        seconds: dict[str, float] = {}
        if request.depth is not None:
            depth = list_images(request.depth, DEPTH_SUFFIXES, role="depth", shared=shared)
            color, depth, seconds = paired(
                color, depth, by=request.pair, skip_unpaired=request.skip_unpaired
            )
        size = _common_size(color)
        names = frame_names(list(color))
        known = [
            Frame(
                id=i, name=names[k], color=f"color/{safe_name(p.stem)}{p.suffix}",
                timestamp=seconds.get(k),
            )
            for i, (k, p) in enumerate(color.items())
        ]  # fmt: skip
        found = frame_cameras(request, known, list(color), size)
        stated = found.depth_unit
        warn_about_gaps(list(color))
        fixed = None if layout is None else layout.depth_scale
        scale = request.depth_scale or stated or fixed or DEFAULT_DEPTH_SCALE
        frames = tuple(
            SourceFrame(
                id=i,
                name=names[key],
                color=SourceFile(source=path, target=f"color/{names[key]}", kind="color"),
                depth=SourceFile(
                    source=depth[key],
                    target=f"depth/{names[key]}",
                    kind="depth",
                    depth_scale=scale,
                )
                if key in depth
                else None,
                camera=found.of.get(key, "color"),
                timestamp=seconds.get(key),
            )
            for i, (key, path) in enumerate(color.items())
        )
        has_units = any(p.suffix.lower() != ".exr" for p in depth.values())
        return Recording(
            source="import:folder",
            cameras=found.cameras,
            frames=frames,
            depth_scale=scale if has_units else None,
            depth_correction=request.depth_correction,
            unit_origin="file" if stated is not None else "format" if fixed else "guess",
        )


def _same_folder(color: str, depth: str) -> bool:
    # A pattern already selects the files.
    return (
        not any(_is_pattern(text) for text in (color, depth))
        and Path(color).resolve() == Path(depth).resolve()
    )


def _is_pattern(text: str) -> bool:
    """Whether a text is a pattern; a folder that exists is none, whatever its name."""
    return any(c in text for c in "*?[") and not Path(text).is_dir()


def _layout_of(request: ImportRequest) -> Layout | None:
    """The layout that folders of colour and depth are parts of, such as rgb/ and depth/ of TUM."""
    if request.color is None or request.depth is None or _is_pattern(request.color):
        return None
    layout = find_layout(Path(request.color).absolute().parent)
    given = [Path(text).resolve() for text in (request.color, request.depth)]
    if layout is None or given != [Path(p).resolve() for p in (layout.color, layout.depth)]:
        return None
    return layout


def _in_layout(request: ImportRequest, layout: Layout) -> ImportRequest:
    """The request with the folders and the intrinsics of a layout."""
    log.logger.info("layout: %s, colour %s, depth %s", layout.kind, layout.color, layout.depth)
    given = request.intrinsics
    if given is None and layout.intrinsics is not None:
        given = str(layout.intrinsics)
    if layout.poses is not None and request.known.cameras is None:
        how = f" --cameras-convention {layout.convention}" if layout.convention else ""
        log.logger.info(
            "camera poses are here, not read: --cameras %s%s", layout.poses, how,
            extra={"doctor": "ignored"},
        )  # fmt: skip
    if layout.kind in ("7scenes", "scannet"):
        log.logger.warning(
            "the depth of %s is that of another camera than the colour, a few pixels off",
            layout.kind,
        )
    depth = layout.depth if request.depth is None else request.depth
    return replace(request, color=layout.color, depth=depth, intrinsics=given)


def _common_size(color: dict[str, Path]) -> tuple[int, int]:
    first = next(iter(color.values()))
    size = image_size(first)
    for path in color.values():
        if (other := image_size(path)) != size:
            raise errors.ToolkitError(
                f"colour images differ in size: {first.name} is {size[0]}x{size[1]}",
                path=path,
                value=f"{other[0]}x{other[1]}",
                hint="one recording has one camera; import them as separate scenes",
            )
    return size


FOLDER = FolderImporter()


def frame_key(stem: str) -> str:
    """The part of a file stem that names the frame: "0007-color" and "depth_0007" give "0007"."""
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
        shared: colour and depth are in one folder: use only names that contain the role's word.

    Raises:
        ToolkitError: no such folder, no images in it, or two images of one frame.
    """
    folder = Path(where)
    if _is_pattern(where):
        parent, pattern = folder.parent, folder.name
        paths = [p for p in _listed(parent, role) if p.match(pattern)]
    else:
        paths = _listed(folder, role)
    paths = [p for p in paths if p.suffix.lower() in suffixes and not p.name.startswith(".")]
    # Masks and previews next to the images are skipped; the role word is needed only in a shared
    # folder.
    if shared:
        wanted = _COLOR_WORDS if role == "color" else _DEPTH_WORDS
        paths = [p for p in paths if wanted & {w.lower() for w in _SEPARATORS.split(p.stem)}]
    if not paths:
        raise errors.ToolkitError(
            f"no {role} images here", path=where, hint=f"files end in {', '.join(suffixes)}"
        )
    found: dict[str, Path] = {}
    for path in sorted(paths, key=lambda p: natural_key(p.stem)):
        key = frame_key(path.stem)
        if key in found:
            raise errors.ToolkitError(
                f"two {role} images of one frame: {found[key].name} and {path.name}",
                path=path.parent,
                value=key,
                hint='choose one kind with a pattern, such as --color "DIR/*-color.png"',
            )
        found[key] = path
    return found


def _listed(folder: Path, role: str) -> list[Path]:
    if folder.is_file():
        raise errors.ToolkitError(
            f"a file, not a folder of {role} images",
            path=folder,
            hint=f'give its folder, or a pattern such as --{role} "DIR/*{folder.suffix}"',
        )
    if not folder.is_dir():
        raise errors.ToolkitError(f"no such folder of {role} images", path=folder)
    found = [p for p in folder.iterdir() if not p.is_dir()]
    for path in found:
        if not path.is_file() and path.suffix.lower() in (*COLOR_SUFFIXES, *DEPTH_SUFFIXES):
            what = "a link to nothing" if path.is_symlink() else "a pipe or device"
            raise errors.ToolkitError(
                f"is {what}, not an image", path=path, hint="remove it, or mount what it is in"
            )
    return [p for p in found if p.is_file()]


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
            raise errors.ToolkitError(
                f"frames {seen[name]!r} and {key!r} map to the same name", value=name
            )
        seen[name] = key
        names[key] = name
    return names


def warn_about_gaps(keys: list[str]) -> None:
    """Warn about gaps in a numbered sequence (dropped or deleted frames)."""
    numbers = [int(m.group(1)) for k in keys if (m := re.search(r"(\d{1,12})$", k))]
    if len(numbers) != len(keys) or len(numbers) < 3:
        return
    steps = [b - a for a, b in pairwise(numbers)]
    usual = sorted(steps)[len(steps) // 2]
    gaps = [i for i, s in enumerate(steps) if s > usual > 0]
    if gaps and usual > 0 and len(gaps) <= len(steps) // 4:
        where = ", ".join(keys[i] for i in gaps[:5])
        log.logger.warning("frames are missing after %s%s", where, " ..." if len(gaps) > 5 else "")
