"""SIFT features of frames, kept on disk so that a killed run does not extract them again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.io.atomic import atomic_path
from std_toolkit.io.images import read_color
from std_toolkit.jobs import JobOptions, run_jobs


@dataclass(frozen=True, eq=False)
class Features:
    """SIFT features of one image.

    Attributes:
        keypoints: (N, 4) float32: x, y in pixels (centres at integers), scale, orientation.
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
    """One image to extract: `fine` starts at twice the resolution."""

    name: str
    image: Path
    size: tuple[int, int]
    fine: bool


def feature_path(folder: Path, name: str) -> Path:
    """File of the features of the frame called `name`."""
    return folder / f"{name}.npz"


def extract_features(
    jobs: Sequence[FeatureJob], folder: Path, *, max_features: int, options: JobOptions
) -> None:
    """Extract the features of every image that has none yet in `folder`.

    Args:
        jobs: the images; names must be unique.
        folder: one file per image; its name must tell the version of the images and options.
        max_features: most features per image.
        options: where the work runs.

    Raises:
        ToolkitError: images that cannot be read (all of them are named).
    """
    folder.mkdir(parents=True, exist_ok=True)
    missing = [job for job in jobs if not feature_path(folder, job.name).exists()]
    if missing:
        run_jobs(
            partial(_extract, folder=folder, max_features=max_features),
            missing,
            name="features",
            key=lambda job: job.name,
            options=options,
        ).raise_if_failed()


def load_features(folder: Path, name: str) -> Features:
    """Read what `extract_features` wrote."""
    with np.load(feature_path(folder, name), allow_pickle=False) as data:
        return Features(data["keypoints"], data["descriptors"])


def _extract(job: FeatureJob, *, folder: Path, max_features: int) -> None:
    import pycolmap

    from std_toolkit.poses.colmap import HALF_PIXEL, quiet_colmap

    grey = cv2.cvtColor(read_color(job.image, size=job.size), cv2.COLOR_RGB2GRAY)
    with quiet_colmap():
        keypoints, descriptors = _extractor(job.fine, max_features).extract_from_uint8_array(grey)
    matrix = np.asarray(pycolmap.keypoints_to_matrix(keypoints), dtype=np.float32).reshape(-1, 4)
    matrix[:, :2] -= HALF_PIXEL
    data = np.asarray(descriptors.data, dtype=np.uint8).reshape(-1, 128)
    with atomic_path(feature_path(folder, job.name)) as path:
        np.savez(path, keypoints=matrix, descriptors=data)


@lru_cache(maxsize=2)
def _extractor(fine: bool, max_features: int) -> Any:
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = 1
    options.sift.max_num_features = max_features
    options.sift.first_octave = -1 if fine else 0
    return pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
