"""Keyframe selection, SIFT features cached on disk, image pairs and descriptor matching.

Keyframes are a small number of sharp frames that cover the whole camera path.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path
from std_toolkit.io.foreign_files import read_npz
from std_toolkit.io.images import read_color
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Floats = NDArray[np.float32]

_WORDS = 32

# COLMAP's default is 0.0067. On an untextured figure this gives three times as many features.
_FAINT_PEAK = 0.002

_SAMPLES = 20_000

# Motion and sharpness are measured on images of about this width: enough for a median over a few
# hundred points, and cheap compared with feature extraction.
SMALL_WIDTH = 400

_CORNERS = 300


@dataclass(frozen=True, kw_only=True)
class TrackSettings(Settings):
    """When the motion between two images can be measured."""

    tracked_share: float = limit(0.5, source=NOT_RECORDED)
    """smallest fraction of corners that must be tracked"""


@dataclass(frozen=True, eq=False)
class Features:
    """SIFT features of one image.

    Attributes:
        keypoints: (N, 4) float32: x, y in pixels (pixel centres at integers), scale, orientation.
        descriptors: (N, 128) uint8 RootSIFT.
    """

    keypoints: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    @property
    def uv(self) -> NDArray[np.float64]:
        """(N, 2) pixels."""
        return self.keypoints[:, :2].astype(np.float64)


@dataclass(frozen=True)
class FeatureJob:
    """One image to extract features from.

    Attributes:
        name: name of the feature file.
        image: the image file.
        size: (width, height).
        fine: whether to start at twice the resolution.
        faint: whether to keep features of low contrast, too.
    """

    name: str
    image: Path
    size: tuple[int, int]
    fine: bool
    faint: bool = False


def feature_path(folder: Path, name: str) -> Path:
    """Path of the feature file of the frame `name`."""
    return folder / f"{name}.npz"


def extract_features(
    jobs: Sequence[FeatureJob], folder: Path, *, max_features: int, options: JobOptions
) -> None:
    """Extract the features of every image that has no file in `folder` yet.

    Args:
        jobs: the images; names must be unique and identify the version of image and options.
        folder: receives one file per image.
        max_features: maximum number of features per image.
        options: where the work runs.

    Raises:
        ToolkitError: images cannot be read; the message names all of them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    missing = [job for job in jobs if not feature_path(folder, job.name).is_file()]
    if missing:
        run_jobs(
            partial(_extract, folder=folder, max_features=max_features),
            missing,
            name="features",
            key=lambda job: job.name,
            options=options,
        ).raise_if_failed()
        _extractor.cache_clear()  # it holds the pyramids of its last image


def load_features(folder: Path, name: str) -> Features:
    """Read the features that `extract_features` wrote.

    Raises:
        ToolkitError: the file was damaged since.
    """
    path = feature_path(folder, name)
    try:
        data = read_npz(path)
        return Features(data["keypoints"], data["descriptors"])
    except (ToolkitError, KeyError) as error:
        problem = error.problem if isinstance(error, ToolkitError) else f"{error} is missing"
        hint = "delete it: features are found again"
        raise ToolkitError(problem, path=path, hint=hint) from error


def _extract(job: FeatureJob, *, folder: Path, max_features: int) -> None:
    color = read_color(job.image, size=job.size)
    found = find_features(color, fine=job.fine, faint=job.faint, max_features=max_features)
    with atomic_path(feature_path(folder, job.name)) as path:
        np.savez(path, keypoints=found.keypoints, descriptors=found.descriptors)


def find_features(
    color: NDArray[np.uint8], *, fine: bool, faint: bool = False, max_features: int
) -> Features:
    """Find the SIFT features of an RGB image (H, W, 3); see `FeatureJob` for the options."""
    import pycolmap

    from std_toolkit.poses.colmap import HALF_PIXEL, quiet_colmap

    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    with quiet_colmap():
        keypoints, descriptors = _extractor(fine, faint, max_features).extract_from_uint8_array(
            grey
        )
    matrix = np.asarray(pycolmap.keypoints_to_matrix(keypoints), dtype=np.float32).reshape(-1, 4)
    matrix[:, :2] -= HALF_PIXEL
    return Features(matrix, np.asarray(descriptors.data, dtype=np.uint8).reshape(-1, 128))


@lru_cache(maxsize=2)
def _extractor(fine: bool, faint: bool, max_features: int) -> Any:
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = 1
    options.sift.max_num_features = max_features
    options.sift.first_octave = -1 if fine else 0
    if faint:
        options.sift.peak_threshold = _FAINT_PEAK
    return pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)


def train_vocabulary(descriptors: Sequence[NDArray[np.uint8]], *, seed: int) -> Floats:
    """Return (K, 128) cluster centres of a sample of the descriptors."""
    pool = np.concatenate(descriptors)
    rng = np.random.default_rng(seed)
    sample = pool[rng.permutation(len(pool))[:_SAMPLES]].astype(np.float32)
    words = min(_WORDS, max(1, len(sample) // 8))
    cv2.setRNGSeed(seed)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 12, 1.0)
    _, _, centres = cv2.kmeans(  # type: ignore[call-overload]
        sample, words, None, criteria, 1, cv2.KMEANS_PP_CENTERS
    )
    return np.asarray(centres, dtype=np.float32)


def describe_image(descriptors: NDArray[np.uint8], vocabulary: Floats) -> Floats:
    """Return the VLAD vector (K * 128,) of an image, normalised to length 1.

    The residuals of the descriptors to their nearest centre are summed and normalised per centre,
    so that repetitive texture does not dominate. Source: Jegou et al., "Aggregating local
    descriptors into a compact image representation", CVPR 2010; normalisation per centre:
    Arandjelovic and Zisserman, "All about VLAD", CVPR 2013.
    """
    out = np.zeros(vocabulary.shape, dtype=np.float32)
    if len(descriptors):
        d = descriptors.astype(np.float32)
        distance = (vocabulary**2).sum(1)[None] - 2 * d @ vocabulary.T
        word = distance.argmin(axis=1)
        for k in range(len(vocabulary)):
            members = d[word == k]
            if len(members):
                out[k] = members.sum(axis=0) - len(members) * vocabulary[k]
    norms = np.linalg.norm(out, axis=1, keepdims=True)
    out = out / np.maximum(norms, 1e-9)
    flat = out.ravel()
    return np.asarray(flat / max(float(np.linalg.norm(flat)), 1e-9), dtype=np.float32)


def choose_pairs(
    image_vectors: Sequence[Floats], *, overlap: int, loops: int
) -> list[tuple[int, int]]:
    """Return the pairs (i < j) of keyframes to match: temporal neighbours and similar images.

    Each keyframe is matched with:

    - its `overlap` next neighbours;
    - keyframes at steps that double from 2 to 8 times `overlap`, for wide baselines with a slow
      camera;
    - the `loops` most similar keyframes outside the neighbourhood.

    The number of pairs is linear in the number of keyframes.
    """
    count = len(image_vectors)
    pairs: set[tuple[int, int]] = set()
    steps = list(range(1, overlap + 1))
    step = 2 * overlap
    while step <= 8 * overlap:
        steps.append(step)
        step *= 2
    for i in range(count):
        pairs.update((i, i + s) for s in steps if i + s < count)
    if loops:
        stack = np.stack(list(image_vectors))
        for i in range(count):
            similarity = stack @ stack[i]
            similarity[max(0, i - overlap) : i + overlap + 1] = -np.inf
            for j in np.argsort(-similarity, kind="stable")[:loops]:
                if np.isfinite(similarity[j]):
                    pairs.add((min(i, int(j)), max(i, int(j))))
    return sorted(pairs)


def match_descriptors(
    a: NDArray[np.uint8], b: NDArray[np.uint8], *, max_ratio: float = 0.85
) -> NDArray[np.int64]:
    """Match mutual nearest neighbours that pass the ratio test: (M, 2) indices into a and b.

    Descriptors are RootSIFT quantised to length 512. Their distance is the angle, as in COLMAP.
    """
    if len(a) == 0 or len(b) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    products = a.astype(np.float32) @ b.astype(np.float32).T
    best = products.argmax(axis=1)
    rows = np.arange(len(a))
    first = products[rows, best]
    mutual = products.argmax(axis=0)[best] == rows
    products[rows, best] = -np.inf
    second = products.max(axis=1)

    near, next_best = (np.arccos(np.clip(x / 512.0**2, -1, 1)) for x in (first, second))
    good = mutual & (near < max_ratio * next_best) & (near < 0.7)
    return np.stack([rows[good], best[good]], axis=1)


@dataclass(frozen=True, kw_only=True)
class FrameMeasure:
    """Measurements of a frame for the keyframe selection.

    Attributes:
        sharpness: variance of the Laplacian of the reduced image.
        motion: image motion since the previous frame, median over tracked corners, as a fraction
            of the image width; 1 if tracking failed.
    """

    sharpness: float
    motion: float


def measure_frames(paths: Sequence[Path]) -> list[FrameMeasure]:
    """Measure the sharpness of every frame and its motion since the previous frame.

    Raises:
        ToolkitError: an image cannot be read.
    """
    measures: list[FrameMeasure] = []
    previous: NDArray[np.uint8] | None = None
    for path in paths:
        # Reduced decoding of a JPEG file takes a fraction of the time.
        grey = cv2.imread(str(path), cv2.IMREAD_REDUCED_GRAYSCALE_2)
        if grey is None:
            raise ToolkitError("cannot decode the image", path=path)
        measure, previous = measure_image(np.asarray(grey, np.uint8), previous)
        measures.append(measure)
    return measures


def measure_image(
    grey: NDArray[np.uint8], previous: NDArray[np.uint8] | None
) -> tuple[FrameMeasure, NDArray[np.uint8]]:
    """Measurements of a grey image (H, W), and its reduced copy, the `previous` of the next."""
    scale = SMALL_WIDTH / grey.shape[1]
    small = grey
    if scale < 1:
        resized = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        small = np.asarray(resized, np.uint8)
    sharpness = float(cv2.Laplacian(small, cv2.CV_32F).var())
    moved = 1.0 if previous is None else _motion(previous, small)
    return FrameMeasure(sharpness=sharpness, motion=moved), small


def choose_keyframes(measures: Sequence[FrameMeasure], *, motion: float, max_gap: int) -> list[int]:
    """Return the indices of the keyframes in ascending order.

    An interval ends where the motion since the last keyframe reaches `motion`, or after `max_gap`
    frames. The keyframe is the sharpest frame in the second half of the interval, so that it has a
    new viewpoint and little blur.

    Args:
        measures: one per frame, in recording order.
        motion: accumulated motion between keyframes, as a fraction of the image width.
        max_gap: largest number of frames between keyframes.
    """
    if not measures:
        return []
    chosen = [0]
    start, moved = 0, 0.0
    for i in range(1, len(measures)):
        moved += measures[i].motion
        if moved < motion and i - start < max_gap:
            continue
        window = range(start + max(1, (i - start + 1) // 2), i + 1)
        best = max(window, key=lambda k: (measures[k].sharpness, k))
        chosen.append(best)
        moved = sum(m.motion for m in measures[best + 1 : i + 1])
        start = best
    last = len(measures) - 1
    if chosen[-1] != last:
        # Without the last frame in the map, the poses near the end would be extrapolated.
        chosen.append(last)
    return chosen


def _motion(previous: NDArray[np.uint8], image: NDArray[np.uint8]) -> float:
    if previous.shape != image.shape:
        return 1.0
    corners = cv2.goodFeaturesToTrack(previous, _CORNERS, 0.01, 7)
    if corners is None or len(corners) < 20:
        return 1.0
    moved, found, _ = cv2.calcOpticalFlowPyrLK(  # type: ignore[call-overload]
        previous, image, corners, None, winSize=(15, 15), maxLevel=4
    )
    kept = found.ravel() > 0
    if kept.mean() < TrackSettings.current().tracked_share:
        return 1.0
    flow = np.linalg.norm((moved - corners).reshape(-1, 2)[kept], axis=1)
    return float(np.median(flow) / image.shape[1])
