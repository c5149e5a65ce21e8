"""Dependencies of agents: vocabularies, none of the server's paths, and packages of exact versions."""

from __future__ import annotations

import json
import re
from pathlib import Path

HERE = Path(__file__).parent
PATHS = re.compile(r"/(resources|topics|services|parameters|mappings|aircraft|engine)\b(?!#)")


def test_an_agent_holds_no_path_of_the_server() -> None:
    for agent in ("pilot.py", "wot.mjs", "rules.n3", "reasoner.mjs"):
        assert not PATHS.search((HERE / agent).read_text()), agent


def test_packages_are_named_by_exact_versions() -> None:
    versions = json.loads((HERE / "package.json").read_text())["dependencies"].values()
    assert all(re.fullmatch(r"\d+\.\d+\.\d+(-[\w-]+)?", version) for version in versions), versions
