"""The JSON Schema files are what the code says, and the documents it writes obey them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import jsonschema
import pytest

from std_toolkit.cli.document_schema import document_schema, document_types, schema_bytes

REPOSITORY = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(REPOSITORY / "tests/std_toolkit/exporters"))


@pytest.mark.parametrize("name", list(document_types()))
def test_schema_files_are_those_of_the_code(name):
    path = REPOSITORY / f"schemas/{name}.schema.json"
    hint = "run `std-curate schema --out schemas`"
    assert path.is_file(), hint
    assert path.read_bytes() == schema_bytes(name), hint


def test_no_schema_file_is_left_over():
    files = {p.name for p in (REPOSITORY / "schemas").iterdir()}
    assert files == {f"{name}.schema.json" for name in document_types()}


@pytest.mark.parametrize("name", list(document_types()))
def test_schemas_are_valid_schemas(name):
    jsonschema.Draft202012Validator.check_schema(document_schema(name))


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> dict[str, Path]:
    """One real document of every kind."""
    from scene_factory import SERIAL, make_scene

    from std_toolkit.checks.check_step import run_check
    from std_toolkit.exporters import export_scene
    from std_toolkit.io.documents import write_document
    from std_toolkit.jobs.artefact import Artefact
    from std_toolkit.options import CheckOptions
    from std_toolkit.project.dataset_card import Dataset, labels_of, models_of
    from std_toolkit.project.people import make_token
    from std_toolkit.project.record import create_project
    from std_toolkit.scene import Annotation, ObjectAnnotation
    from std_toolkit.scene.review import Review, add_review, label_digests

    folder = tmp_path_factory.mktemp("documents")
    scene = make_scene(folder / "scene", frames=2, unregistered=[1], size=(64, 48))
    sidecar = export_scene(scene, "std", folder / "std", jobs=SERIAL)
    Artefact(scene.root, "demo", {"images": "0" * 32}).write([scene.root / "frames.json"])
    run_check(scene, CheckOptions(max_frames=1), SERIAL)
    scene.save_annotation(Annotation(objects=[ObjectAnnotation(object=1, status="done")]))
    said = {"time": "2026-03-02T09:30:00Z", "by": "ben", "verdict": "accepted"}
    add_review(scene, Review(**said, labels=label_digests(scene)))
    project, _ = create_project(folder / "project", scenes=[scene.root], people=["ben"], rules=None)
    make_token(project, "ben")
    made = {"name": "a", "layout": "std", "tool": "1", "licence": "b", "rule": "c", "digest": "d"}
    found = {"models": models_of([sidecar]), "labels": labels_of([sidecar])}
    dataset = Dataset(**made, **found, splits={"test": ["e"]}, scenes=[], files={})
    write_document(folder / "dataset.json", dataset)
    names = ("scene", "frames", "objects", "poses", "labels", "annotation", "review")
    return {n: scene.root / f"{n}.json" for n in names} | {
        "check_report": scene.root / "check/report.json",
        "ground_truth": scene.root / "gt/info/000000.json",
        "record": scene.root / ".std/records/demo.json",
        "export": folder / "std/std_toolkit.json",
        "project": folder / "project/project.json",
        "tokens": folder / "project/.std/tokens.json",
        "dataset": folder / "dataset.json",
    }


@pytest.mark.parametrize("name", list(document_types()))
def test_documents_obey_their_schema(name, written):
    schema = document_schema(name)
    document = json.loads(written[name].read_text())
    jsonschema.validate(document, schema, cls=jsonschema.Draft202012Validator)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**document, "surprise": 1}, schema)


EXAMPLE = "<!-- example: "


def test_every_example_of_the_specification_obeys_its_schema():
    """data_spec.md marks its JSON examples with the kind of document they are."""
    text = (REPOSITORY / "data_spec.md").read_text()
    seen = set()
    for part in text.split(EXAMPLE)[1:]:
        name = part.split(" ", 1)[0]
        body = part.split("```json\n", 1)[1].split("```", 1)[0]
        jsonschema.validate(json.loads(body), document_schema(name))
        import msgspec

        msgspec.json.decode(body.encode(), type=document_types()[name])
        seen.add(name)
    assert seen == set(document_types())
