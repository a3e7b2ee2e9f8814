"""The report of a scan: photos beside the re-rendered mesh, errors, coverage, scale."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit import __version__
from std_toolkit.geometry.camera import pixel_rays
from std_toolkit.geometry.crossing_faces import crossing_faces
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.html.page import (
    Bullets,
    Fact,
    Figure,
    Gallery,
    Page,
    Paragraph,
    Picture,
    Section,
    Verdict,
)
from std_toolkit.html.table import text_table
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import write_document
from std_toolkit.scanning.model.bake import rendered, texels_at
from std_toolkit.scanning.model.write_model import Scan, guessed_name
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.photos.visibility import hull_depth
from std_toolkit.scanning.surface.surface import is_closed
from std_toolkit.settings import Settings, limit

_SHOWN = 8
_WIDTH = 420


def outline_overlap(view: View, caster: RayCaster) -> float:
    """Intersection over union of the mask and the outline of the mesh in one photo."""
    whole = (0, 0, view.camera.width, view.camera.height)
    drawn = hull_depth(view, caster, np.zeros(3), whole)[0] > 0
    if view.hidden is not None:
        drawn &= ~view.hidden
    union = (drawn | view.shown).sum()
    return float((drawn & view.shown).sum() / union) if union else 0.0


@dataclass(frozen=True, kw_only=True)
class ReportSettings(Settings):
    """From when a mesh must not be used."""

    least_overlap: float = limit(
        0.75, source="right scans have 0.95; the advice doubts single photos below 0.9"
    )
    """smallest median, over the photos, of the overlap of the mesh's outline with the mask"""
    least_seen: float = limit(0.2, source="one side of a box is a sixth of it")
    """smallest share of the surface that a photo shows"""


def write_report(folder: Path, scan: Scan) -> Scan:
    """Write `report.html` and `scan.json` of a model whose files are written.

    Returns:
        The scan with all advice among its warnings, and why the mesh must not be used, if so.
    """
    caster = RayCaster(scan.vertices, scan.faces)
    overlaps = [outline_overlap(v, caster) for v in scan.views]
    corners = scan.vertices[scan.faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    share = area / area.sum()
    measured = float(share[scan.supported].sum())
    seen = float(share[scan.texture.seen > 0].sum())
    figures, residuals = _figures(scan, caster)
    extents = np.ptp(scan.vertices, axis=0)
    facts = {
        **scan.facts,
        "extent": " x ".join(f"{1000 * x:.1f}" for x in extents) + " mm",
        "faces": len(scan.faces),
        "crossing faces": int(crossing_faces(scan.vertices, scan.faces).sum()),
        "outline overlap": f"{np.mean(overlaps):.3f} (lowest {np.min(overlaps):.3f})",
        "colour residual": f"{np.median(residuals):.1f} grey values",
        "supported by depth": f"{100 * measured:.0f} % of the surface",
        "seen by a photo": f"{100 * seen:.0f} % of the surface",
        "guessed texture": f"{100 * _guessed(scan, share):.0f} %, marked in "
        f"{guessed_name(scan.name)} and by the property guessed of {scan.name}.ply",
    }
    closed = written_closed(folder / f"{scan.name}.ply")
    faults = _faults(closed, float(np.median(overlaps)), seen)
    warnings = [*scan.warnings, *_advice(scan, share, overlaps)]
    document: dict[str, Any] = {
        "tool": f"std-toolkit {__version__}",
        "name": scan.name,
        **{k.replace(" ", "_"): v for k, v in facts.items()},
        "outline_overlaps": {
            v.name: round(o, 4) for v, o in zip(scan.views, overlaps, strict=True)
        },
        "usable": not faults,
        "faults": faults,
        "warnings": warnings,
        "seconds": {k: round(v, 1) for k, v in scan.seconds.items()},
    }
    write_document(folder / "scan.json", document)
    advice = [Paragraph(w) for w in warnings]
    rows = [[v.name, f"{o:.3f}"] for v, o in zip(scan.views, overlaps, strict=True)]
    page = Page(
        kind="Scan",
        title=scan.name,
        footer=f"std-scan, std-toolkit {__version__}",
        facts=[Fact(k, str(v)) for k, v in facts.items()],
        verdicts=[
            Verdict("the mesh is watertight", "closed", "pass") if closed
            else Verdict("the mesh is not watertight", "open", "fail"),
            *(Verdict(f"must not be used: {fault}", "wrong", "fail") for fault in faults),
        ],
        sections=[
            Section("advice", "What to photograph again", [Bullets(advice)]),
            Section(
                "views",
                "Photos beside the mesh",
                [
                    Paragraph(
                        "Each row: the photo with the outline of its mask, the mesh with its "
                        "texture from the same camera, the difference, and the surface: grey is "
                        "supported by depth maps, orange is closed from the outlines alone."
                    ),
                    Gallery(figures, heads=("photo", "mesh", "difference", "surface")),
                ],
            ),
            Section(
                "outlines",
                "Outline overlap",
                [text_table(["photo", "overlap"], rows, texts=1)],
            ),
            Section(
                "time",
                "Time",
                [text_table(["stage", "seconds"],
                            [[k, f"{v:.1f}"] for k, v in scan.seconds.items()], texts=1)],
            ),
        ],
    )  # fmt: skip
    write_bytes_atomic(folder / "report.html", page.html().encode())
    return replace(scan, warnings=warnings, faults=faults)


def written_closed(path: Path) -> bool:
    """Whether the mesh of a file is an oriented 2-manifold without borders.

    Vertices that are less than the numbers of the file apart are one there.
    """
    import trimesh

    mesh = trimesh.load_mesh(path, process=False)
    return is_closed(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64))


def _faults(closed: bool, overlap: float, seen: float) -> list[str]:
    """Why a mesh must not be used."""
    limits = ReportSettings.current()
    found = []
    if not closed:
        found.append("the mesh is not watertight")
    if overlap < limits.least_overlap:
        found.append(
            f"its outline overlaps with the masks by {overlap:.2f} in the median: it is not the "
            "object that the photos show"
        )
    if seen < limits.least_seen:
        found.append(f"photos show {100 * seen:.0f} % of its surface; the rest is a guess")
    return found


def _guessed(scan: Scan, share: NDArray[np.float64]) -> float:
    """Part of the surface whose texture no photo shows, by the middle of its faces."""
    row, column = texels_at(scan.texture, scan.texture.uv.mean(axis=1))
    return float(share[scan.texture.guessed[row, column]].sum())


def _advice(scan: Scan, share: NDArray[np.float64], overlaps: list[float]) -> list[str]:
    """What to photograph again, from where the surface was not seen."""
    corners = scan.vertices[scan.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-20
    unseen = scan.texture.seen == 0
    found = []
    names = {(2, 1): "from above", (2, -1): "from below: turn the object over", (0, 1): "from +x",
             (0, -1): "from -x", (1, 1): "from +y", (1, -1): "from -y"}  # fmt: skip
    for (axis, sign), words in names.items():
        part = float(share[unseen & (sign * normal[:, axis] > 0.7)].sum())
        if part > 0.03:
            found.append(
                f"{100 * part:.0f} % of the surface was seen by no photo and closed by guess: "
                f"photograph it {words}"
            )
    guessed = float(share[~scan.supported & ~unseen].sum())
    if guessed > 0.3:
        found.append(
            f"{100 * guessed:.0f} % of the surface has too little texture for depth and is that "
            "of the outlines: hollows there are filled; more photos make outlines finer. Is the "
            "object glass or polished metal? Spray it matt and photograph it again"
        )
    poor = [v.name for v, o in zip(scan.views, overlaps, strict=True) if o < 0.75]
    if len(poor) >= 3:
        found.append(
            f"did the object move? {len(poor)} photos do not fit the others: {', '.join(poor[:5])}"
        )
    bad = [v.name for v, o in zip(scan.views, overlaps, strict=True) if o < 0.9]
    if bad:
        found.append(
            f"the outline of the mesh differs from the mask in {len(bad)} photos "
            f"({', '.join(bad[:5])}): look at them below, and correct masks with --masks"
        )
    return found


def _figures(scan: Scan, caster: RayCaster) -> tuple[list[Figure], NDArray[np.float64]]:
    step = max(1, len(scan.views) // _SHOWN)
    figures = []
    residuals = []
    for i in range(0, len(scan.views), step):
        cut, residual = _panels(scan, i, caster)
        residuals.append(residual)
        height = max(1, round(_WIDTH * cut[0].shape[0] / cut[0].shape[1]))
        row = np.hstack([cv2.resize(p, (_WIDTH, height)) for p in cut])
        data = cv2.imencode(".webp", row[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, 80])[1]
        picture = Picture(data.tobytes(), "image/webp", 4 * _WIDTH, height)
        figures.append(Figure(picture, scan.views[i].name))
    return figures, np.concatenate(residuals) if residuals else np.zeros(1)


def mesh_panels(scan: Scan, photo: str) -> list[NDArray[np.uint8]]:
    """The mesh as a photo shows it (h, w, 3): with its texture, and its shaded surface.

    Args:
        scan: the model.
        photo: name; the first photo if the model has none of this name.
    """
    names = [v.name for v in scan.views]
    i = names.index(photo) if photo in names else 0
    panels, _ = _panels(scan, i, RayCaster(scan.vertices, scan.faces))
    return [panels[1], panels[3]]


def _panels(
    scan: Scan, i: int, caster: RayCaster
) -> tuple[list[NDArray[np.uint8]], NDArray[np.float64]]:
    """Photo, mesh, difference and surface around the object, and the grey values they differ by."""
    view = scan.views[i]
    drawn, mask = rendered(view, caster, scan.texture)
    gain = scan.texture.gains[i]
    drawn = np.clip(drawn * gain, 0, 255).astype(np.uint8)
    both = mask & view.shown
    off = np.abs(drawn.astype(np.int16) - view.image).mean(axis=-1)
    outlined = view.image.copy()
    contours, _ = cv2.findContours(
        view.shown.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(outlined, contours, -1, (255, 40, 40), 1)
    difference = np.zeros_like(view.image)
    difference[both] = cv2.applyColorMap(
        np.clip(off * 4, 0, 255).astype(np.uint8), cv2.COLORMAP_INFERNO
    )[..., ::-1][both]
    difference[mask ^ view.shown] = (0, 160, 255)
    window = _window(mask | view.shown)
    panels = [outlined, drawn, difference, _shaded(scan, view, caster)]
    return [p[window] for p in panels], off[both]


def _shaded(scan: Scan, view: View, caster: RayCaster) -> NDArray[np.uint8]:
    local = pixel_rays(view.camera)
    rays = np.empty((*local.shape[:2], 6), np.float32)
    rays[..., :3] = view.centre
    rays[..., 3:] = local @ view.T_world_cam.R.T
    hits = caster.cast(rays)
    hit = np.isfinite(hits.distance)
    ray = rays[..., 3:] / np.linalg.norm(rays[..., 3:], axis=-1, keepdims=True)
    light = np.abs((hits.normal * ray).sum(axis=-1))
    sure = np.zeros(hit.shape, bool)
    sure[hit] = scan.supported[hits.face[hit].astype(np.int64)]
    color = np.where(sure[..., None], [210, 210, 215], [240, 150, 60])
    out = (color * (0.25 + 0.75 * light[..., None])).astype(np.uint8)
    out[~hit] = 20
    return out


def _window(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return slice(0, mask.shape[0]), slice(0, mask.shape[1])
    margin = 12
    return (
        slice(max(0, rows[0] - margin), rows[-1] + margin),
        slice(max(0, columns[0] - margin), columns[-1] + margin),
    )
