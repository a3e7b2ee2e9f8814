"""review.json: what reviewers said of the labels of a scene, and how far it still holds.

The file lies in the scene, so that whoever opens the scene reads why it was sent back, with or
without the project that it belongs to. It is a document of its own: the annotation tool rewrites
annotation.json from its session, while a person may review from another computer.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import digest_of, read_document, write_document
from std_toolkit.io.locks import hold_lock
from std_toolkit.scene.document import Document
from std_toolkit.scene.pose_model import Time
from std_toolkit.scene.scene import Scene

FILE = "review.json"
LOCK = "review.lock"

Person = Annotated[str, msgspec.Meta(min_length=1, max_length=80)]
Sentence = Annotated[str, msgspec.Meta(max_length=2000)]


Verdict = Literal["accepted", "sent back", "noted"]


class Review(Document, frozen=True, kw_only=True):
    """What one person said at one time.

    Attributes:
        time: when, UTC, ISO 8601.
        by: the reviewer.
        verdict: "accepted" or "sent back"; "noted" gives reasons or a comment only.
        reason: why the scene was sent back; of a note, a comment; else "".
        reasons: text by name of the object: why its label is kept although the check doubts it or,
            where the scene is sent back, what is wrong with it.
        labels: digest of each label that was reviewed, by name of the object.
    """

    time: Time
    by: Person
    verdict: Verdict
    reason: Sentence = ""
    reasons: dict[str, Sentence] = msgspec.field(default_factory=dict)
    labels: dict[str, str]

    def check(self) -> None:
        if self.verdict == "sent back" and not (self.reason or self.reasons):
            raise ToolkitError("a scene is sent back with a reason", field="reason", value="")


class Reviews(Document, frozen=True, kw_only=True):
    """review.json: all reviews of a scene in the order of time; none is ever removed."""

    reviews: list[Review] = msgspec.field(default_factory=list)


@dataclass(frozen=True)
class Standing:
    """What the reviews say of the present labels.

    Attributes:
        by: who accepted the scene or sent it back; "" if nobody did, or the labels changed since.
        accepted: whether that person accepted it.
        reason: why it was sent back.
        refused: names of the objects whose labels were sent back and are as they were then.
        reasons: text by name of the object and reviewer, for labels that did not change since.
    """

    by: str = ""
    accepted: bool = False
    reason: str = ""
    refused: frozenset[str] = frozenset()
    reasons: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


def read_reviews(root: Path) -> Reviews:
    """The reviews of a scene; empty without any.

    Raises:
        ToolkitError: review.json is damaged.
    """
    path = root / FILE
    return read_document(path, Reviews) if path.is_file() else Reviews()


def add_review(scene: Scene, review: Review) -> None:
    """Append a review, after those that others wrote in the meantime.

    Raises:
        ToolkitError: review.json is damaged, or the folder cannot be written to.
    """
    with _alone(scene.root):
        found = [*read_reviews(scene.root).reviews, review]
        write_document(scene.root / FILE, Reviews(reviews=found))


@contextmanager
def _alone(root: Path) -> Iterator[None]:
    # Not the lock of the scene: a check that runs for minutes does not stop a reviewer.
    with hold_lock(root, LOCK, doing="reviewing", wait=True, deep=False):
        yield


def label_digests(scene: Scene) -> dict[str, str]:
    """Digest of each label by name of its object: of the pose, the mesh and its symmetry.

    What the check says of a label does not change it.
    """
    models = {m.id: m for m in scene.objects.models}
    found = {}
    for item in scene.objects.objects:
        label = scene.labels.of(item.id)
        if label is not None:
            pose = label.T_world_obj or label.T_cam_obj
            found[item.name] = digest_of(pose, models[item.model], item.material, versioned=False)
    return found


def standing(reviews: Reviews, labels: Mapping[str, str]) -> Standing:
    """What the reviews say of the labels of these digests.

    An acceptance holds until any label changes. A scene that was sent back for named objects is so
    until all of their labels changed, otherwise until any label changed.
    """
    reasons: dict[str, dict[str, str]] = {}
    last = None
    for review in reviews.reviews:
        last = review if review.verdict != "noted" else last
        if review.verdict != "sent back":
            for name, text in review.reasons.items():
                if name in labels and labels[name] == review.labels.get(name):
                    reasons.setdefault(name, {})[review.by] = text
    if last is None:
        return Standing(reasons=reasons)
    unchanged = labels == last.labels
    if last.verdict == "accepted":
        return Standing(last.by, True, reasons=reasons) if unchanged else Standing(reasons=reasons)
    if last.reasons:
        # A label that was removed changed, too.
        refused = {n for n in last.reasons if n in labels and labels[n] == last.labels.get(n)}
    else:
        refused = set(labels) if unchanged else set()
    if not refused:
        return Standing(reasons=reasons)
    about = [last.reason, *(f"{n}: {last.reasons[n]}" for n in sorted(refused & {*last.reasons}))]
    text = "; ".join(filter(None, about))
    return Standing(last.by, False, text, frozenset(refused), reasons)
