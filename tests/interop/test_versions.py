"""The clients have exact versions, in every package manager."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

HERE = Path(__file__).parent
EXACT = re.compile(r"\d+(\.\d+)+(-alpha\.\d+)?")


def test_packages_for_node_are_of_exact_versions() -> None:
    wanted: dict[str, str] = json.loads((HERE / "javascript" / "package.json").read_text())["dependencies"]
    assert all(EXACT.fullmatch(version) for version in wanted.values()), wanted
    assert lock()["packages"][""]["dependencies"] == wanted


def test_the_lock_names_contents_and_no_registry() -> None:
    packages = [each for name, each in lock()["packages"].items() if name]
    assert all(each["integrity"] for each in packages)
    assert not [each for each in packages if "resolved" in each]


@pytest.mark.parametrize("folder", ["geosparql", "java", "ontology", "shapes"])
def test_libraries_for_java_are_of_exact_versions(folder: str) -> None:
    pom = ElementTree.parse(HERE / folder / "pom.xml")
    versions = [each.text or "" for each in pom.iterfind(".//{*}dependency/{*}version")]
    assert len(versions) == len([*pom.iterfind(".//{*}dependency")])
    assert all(EXACT.fullmatch(version) for version in versions), versions


def lock() -> Any:
    return json.loads((HERE / "javascript" / "package-lock.json").read_text())
