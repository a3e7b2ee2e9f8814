"""What a propagation warns of reaches the person: nobody reads stderr beside a window."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from desk_without_window import Desk
from scene_on_disk import write_scene

from annotator.app import operations
from annotator.session.saving import propagate_saved_labels
from std_toolkit.labels import propagate
from std_toolkit.log import collected_warnings, logger


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(write_scene(tmp_path / "scene").root)
    made.controller.select("box_1")
    yield made
    made.close()


def test_warnings_are_told(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    carried = propagate.propagate_labels

    def unsettled(*arguments: object) -> object:
        logger.warning("%s: the refinement did not settle; check its label", "box_1")
        return carried(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(propagate, "propagate_labels", unsettled)
    desk.controller.nudge(shift=(1, 0, 0))
    operations.propagate(desk.controller)
    desk.wait_until_idle()
    warned, done = desk.told("message")[-2:]
    assert warned.level == "warning"
    assert warned.text == "box_1: the refinement did not settle; check its label."
    assert done.level == "info" and done.text.startswith("Carried to ")


def test_without_trouble_there_is_none(desk: Desk) -> None:
    operations.save(desk.controller)
    assert propagate_saved_labels(desk.session.scene.root).warnings == ()


def test_what_other_threads_warn_of_is_not_collected() -> None:
    with collected_warnings() as said:
        other = threading.Thread(target=lambda: logger.warning("of another computation"))
        other.start()
        other.join()
        logger.info("that all is well")
        logger.warning("of %s", "this one")
    logger.warning("too late")
    assert said == ["of this one"]
