"""Which images to match, and descriptor matching between a frame and the map."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

_WORDS = 32
_SAMPLES = 20_000


def train_vocabulary(descriptors: Sequence[NDArray[np.uint8]], *, seed: int) -> Floats:
    """(K, 128) cluster centres of a sample of the recording's own descriptors."""
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
    """One vector (K * 128,) of length 1 for a whole image.

    VLAD: residuals of the descriptors to their nearest centre, summed per centre and normalised
    per centre, so that repetitive texture does not drown the rest. Source: Jegou et al.,
    "Aggregating local descriptors into a compact image representation", CVPR 2010; the
    normalisation per centre: Arandjelovic and Zisserman, "All about VLAD", CVPR 2013.
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
    """Pairs (i < j) of keyframes to match: neighbours in time, and look-alikes elsewhere.

    Linear in the number of keyframes: `overlap` neighbours, doubled steps beyond them (so that a
    slow camera still gets wide baselines) up to 8 times the overlap, and `loops` most similar
    keyframes outside the neighbourhood.
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
    """Mutual nearest neighbours that pass the ratio test: (M, 2) indices into a and b.

    Descriptors are RootSIFT quantised to length 512, compared by angle as COLMAP does.
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
    # The angle between two unit vectors, as COLMAP measures descriptor distance.
    near, next_best = (np.arccos(np.clip(x / 512.0**2, -1, 1)) for x in (first, second))
    good = mutual & (near < max_ratio * next_best) & (near < 0.7)
    return np.stack([rows[good], best[good]], axis=1)
