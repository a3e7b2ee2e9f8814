"""The documents of a BOP data set."""

import json
from typing import Any

from std_toolkit import __version__
from std_toolkit.exporters.exporter import FrameRow, Target
from std_toolkit.scene.sidecar import ExportedModel

# An instance counts as a target of the BOP Challenge from this visible fraction on.
TARGET_VISIBLE = 0.1


def record_lines(content: dict[str, Any] | list[Any]) -> bytes:
    """JSON with one record per line, keys sorted, as bop_toolkit writes it."""
    if isinstance(content, dict):
        # Numbers as keys sort by value: image 10 comes after image 9.
        keys = sorted(content, key=lambda k: (int(k) if k.isdigit() else -1, k))
        lines = [f"  {json.dumps(k)}: {_dump(content[k])}" for k in keys]
        return ("{\n" + ",\n".join(lines) + "\n}\n").encode()
    lines = [f"  {_dump(x)}" for x in content]
    return ("[\n" + ",\n".join(lines) + "\n]\n").encode()


def targets_19(target: Target, rows: list[FrameRow]) -> list[dict[str, int]]:
    """test_targets_bop19.json: instances of which at least a tenth is visible."""
    found = []
    for row in rows:
        counts: dict[int, int] = {}
        for gt, info in zip(row.extra["gt"], row.extra["gt_info"], strict=True):
            if info["visib_fract"] >= TARGET_VISIBLE:
                counts[gt["obj_id"]] = counts.get(gt["obj_id"], 0) + 1
        found += [
            {
                "im_id": row.frame.id,
                "inst_count": count,
                "obj_id": number,
                "scene_id": target.options.scene_number,
            }
            for number, count in sorted(counts.items())
        ]
    return found


def targets_24(target: Target, rows: list[FrameRow]) -> list[dict[str, int]]:
    """test_targets_bop24.json: the images only, because 6D detection must find the objects."""
    number = target.options.scene_number
    return [{"im_id": row.frame.id, "scene_id": number} for row in rows]


def coco_document(
    target: Target, rows: list[FrameRow], models: list[ExportedModel], *, modal: bool = False
) -> bytes:
    """scene_gt_coco.json: modal masks as run lengths, amodal boxes clipped to the image.

    With `modal`, scene_gt_coco_modal.json: boxes around the visible part.
    """
    name = target.scene.info.name
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for row in rows:
        width, height = row.extra["size"]
        images.append(
            {
                "coco_url": "",
                "date_captured": "",
                "file_name": f"rgb/{row.frame.stem}.png",
                "flickr_url": "",
                "height": height,
                "id": row.frame.id,
                "license": 1,
                "width": width,
            }
        )
        annotations += [
            {
                **a,
                **({"bbox": _box_of_runs(**a["segmentation"])} if modal else {}),
                "id": len(annotations) + k + 1,
                "image_id": row.frame.id,
            }
            for k, a in enumerate(row.extra["coco"])
        ]
    document = {
        "annotations": annotations,
        "categories": [
            {"id": int(m.layout_id), "name": m.layout_id, "supercategory": name} for m in models
        ],
        "images": images,
        "info": {
            "contributor": "",
            "date_created": "",
            "description": f"{name}_{target.options.split}",
            "url": "",
            "version": __version__,
            "year": 0,
        },
        "licenses": [],
    }
    return (_dump(document) + "\n").encode()


def _box_of_runs(counts: list[int], size: list[int]) -> list[int]:
    """[x, y, width, height] of the pixels of COCO's run lengths, column by column.

    >>> _box_of_runs([4, 2, 1, 1], [3, 3])  # the rest is empty
    [1, 1, 2, 2]
    """
    height, place = size[0], 0
    columns, tops, bottoms = [], [], []
    for i, count in enumerate(counts):
        if i % 2 and count:
            first, last = place, place + count - 1
            columns += [first // height, last // height]
            over = first // height != last // height
            tops.append(0 if over else first % height)
            bottoms.append(height - 1 if over else last % height)
        place += count
    x, y = min(columns), min(tops)
    return [x, y, max(columns) - x + 1, max(bottoms) - y + 1]


def dataset_info(target: Target, rows: list[FrameRow], models: list[ExportedModel]) -> bytes:
    """dataset_info.json: names and materials of the ids, and how visibility was computed."""
    scene = target.scene
    truths = {(r.truth.policy, r.truth.delta_m, r.truth.renderer) for r in rows}
    poses = scene.poses
    document = {
        "name": scene.info.name,
        "generator": f"std-toolkit {__version__}",
        "images": len(rows),
        "objects": [
            {
                "obj_id": int(m.layout_id),
                "model": m.model,
                "category": scene.objects.model(m.model).category,
                "materials": sorted(
                    {o.material for o in scene.objects.objects if o.model == m.model}
                ),
            }
            for m in models
        ],
        "visibility": [
            {
                "policy": policy,
                "delta_mm": None if delta is None else 1000 * delta,
                "renderer": name,
            }
            for policy, delta, name in sorted(truths, key=str)
        ],
        "scale": None
        if poses is None or poses.scale is None
        else {"chosen": poses.scale.chosen, "unit": poses.scale.unit},
        "depth_correction": scene.info.depth_correction,
        "pixel_centres": "integer",
    }
    return (json.dumps(document, indent=2, sort_keys=True) + "\n").encode()


def dataset_text(target: Target, rows: list[FrameRow], models: list[ExportedModel]) -> bytes:
    """dataset_info.md, a description for readers."""
    scene = target.scene
    policies = sorted({r.truth.policy for r in rows})
    lines = [
        f"# {scene.info.name}",
        "",
        f"{len(rows)} images, {len(models)} models, written by std-toolkit {__version__} in the "
        "layout of the BOP benchmark. Millimetres; model to camera; world to camera.",
        "",
        "Pixel centres are at integer coordinates in K, masks and depth. The renderer of "
        "bop_toolkit puts them at +0.5 with the same K, so masks that it renders are shifted by "
        "half a pixel relative to these. For scripts of bop_toolkit that render, such as "
        "eval_calc_errors.py for VSD, add 0.5 to cx and cy.",
        "",
        f"Occluders besides the labelled objects: {', '.join(policies)} (models: none; sensor: "
        "depth of the frame; fused: geometry fused from many frames). Sensor depth is wrong on "
        "transparent and specular objects: do not derive visibility from it there.",
        "",
        "Model frames are those of the source meshes, moved to the centre of the bounding box; "
        "they are not rotated to z up.",
        "",
        "| obj_id | model | category | material |",
        "|---|---|---|---|",
    ]
    for m in models:
        materials = sorted({o.material for o in scene.objects.objects if o.model == m.model})
        category = scene.objects.model(m.model).category
        lines.append(f"| {m.layout_id} | {m.model} | {category} | {', '.join(materials)} |")
    return ("\n".join(lines) + "\n").encode()


def _dump(value: Any) -> str:
    return json.dumps(value, sort_keys=True)
