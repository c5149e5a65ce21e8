"""The picture of the ontology in the documentation matches the ontology's files."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

from rosld.ontology.modules import home_of_terms
from rosld.ontology.vocab import ros

SCRIPT = Path(__file__).parents[2] / "docs" / "ontology_picture.py"


def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("ontology_picture", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_picture_is_what_the_files_say() -> None:
    drawn = script()
    assert drawn.PICTURE.read_text(encoding="utf-8") == drawn.draw(), "run python docs/ontology_picture.py"


def test_every_class_in_the_picture_is_one_and_every_line_has_a_property() -> None:
    drawn = script()
    assert {ros.iri + name for name in drawn.BOXES} <= home_of_terms().keys()
    assert all(drawn.lines_between(list(drawn.relations())).values())
    texts = [each.text or "" for each in ElementTree.fromstring(drawn.draw()).iter("{http://www.w3.org/2000/svg}text")]
    assert any("publishes / publishedBy" in text for text in texts)
