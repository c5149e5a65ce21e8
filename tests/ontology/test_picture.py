"""The picture of the ontology in the documentation matches the ontology's files."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

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
