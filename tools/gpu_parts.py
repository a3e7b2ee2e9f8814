"""Frames of packs in files that are small enough to be sent, for tools/gpu_run.py."""

import lzma
import zlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np

_PER_M = 1e4  # steps of the stored inverse depth: 0.05 mm at 0.7 m
_QUALITY = 90  # of the stored colour


def write_parts(folder: Path, packs: Sequence[Path], most_mb: float) -> None:
    """Write the frames of packs, shuffled, as folder/part-NN.npz of at most some megabytes."""
    from benchmark.training.packed_frames import PackedFrames

    frames = PackedFrames(packs)
    order = np.random.default_rng(0).permutation(len(frames))
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.glob("part-*.npz")):
        raise SystemExit(f"error: {folder} holds parts: choose another folder")
    part: list[dict[str, bytes]] = []
    size, number = 0, 0

    def write() -> None:
        nonlocal part, size, number
        blobs = [blob for record in part for blob in record.values()]
        ends = np.cumsum([len(blob) for blob in blobs])
        path = folder / f"part-{number:02d}.npz"
        np.savez(
            path,
            size=np.array(frames.size),
            names=np.array(list(part[0])),
            ends=ends,
            bytes=np.frombuffer(b"".join(blobs), np.uint8),
        )
        path.with_name(f"{path.name}.done").touch()
        print(f"{path}: {len(part)} frames, {path.stat().st_size / 1e6:.1f} MB")
        part, size, number = [], 0, number + 1

    with ThreadPoolExecutor(2) as pool:
        for record in pool.map(lambda i: _stored(frames.record(int(i))), order):
            length = sum(map(len, record.values()))
            if part and size + length > most_mb * 1e6:
                write()
            part.append(record)
            size += length
    write()


def _stored(record: Any) -> dict[str, bytes]:
    """A frame's record as small files."""
    color = record["color"][..., ::-1]
    same = np.array_equal(record["raw"], record["true"])
    return {
        "color": cv2.imencode(".webp", color, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])[1].tobytes(),
        "true": _packed(record["true"]),
        "raw": b"" if same else _packed(record["raw"]),
        "mask": zlib.compress(record["mask"].tobytes(), 9),
        "materials": record["materials"].tobytes(),
        "K": record["K"].tobytes(),
    }


def _packed(depth: np.ndarray) -> bytes:
    """Depth as second differences of its inverse, which are nearly 0 on planes."""
    depth = depth.astype(np.float64)
    inverse = np.where(depth > 0, np.rint(_PER_M / np.maximum(depth, 0.16)), 0).astype(np.int64)
    apart = np.diff(np.diff(inverse, axis=0, prepend=0), axis=1, prepend=0)
    numbers = ((apart << 1) ^ (apart >> 63)).astype("<u4")  # small ones whatever their sign
    return lzma.compress(numbers.view(np.uint8).reshape(-1, 4).T.tobytes(), preset=6)


def _unpacked(data: bytes, h: int, w: int) -> np.ndarray:
    found = np.frombuffer(lzma.decompress(data), np.uint8).reshape(4, -1)
    numbers = np.ascontiguousarray(found.T).view("<u4").astype(np.int64).reshape(h, w)
    apart = (numbers >> 1) ^ -(numbers & 1)
    inverse = apart.cumsum(axis=1).cumsum(axis=0)
    return np.where(inverse > 0, _PER_M / np.maximum(inverse, 1), 0).astype(np.float32)


def read_part(path: Path) -> dict[str, np.ndarray]:
    """Arrays over the frames of a part: color, raw, true, mask, materials, K."""
    with np.load(path) as file:
        (w, h), names, ends = file["size"].tolist(), file["names"].tolist(), file["ends"]
        data = file["bytes"].tobytes()
    begins = np.concatenate([[0], ends[:-1]])
    blobs = [data[a:b] for a, b in zip(begins, ends, strict=True)]
    rows = [
        dict(zip(names, blobs[i : i + len(names)], strict=True))
        for i in range(0, len(blobs), len(names))
    ]

    def frame(row: dict[str, bytes]) -> dict[str, np.ndarray]:
        color = cv2.imdecode(np.frombuffer(row["color"], np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        true = _unpacked(row["true"], h, w)
        return {
            "color": color,
            "true": true,
            "raw": _unpacked(row["raw"], h, w) if row["raw"] else true,
            "mask": np.frombuffer(zlib.decompress(row["mask"]), np.uint8).reshape(h, w),
            "materials": np.frombuffer(row["materials"], np.uint8),
            "K": np.frombuffer(row["K"], np.float32).reshape(3, 3),
        }

    with ThreadPoolExecutor() as pool:
        found = list(pool.map(frame, rows))
    return {name: np.stack([one[name] for one in found]) for name in found[0]}
