"""Dependencies of agents: vocabularies, and none of the server's paths."""

from __future__ import annotations

import re
from pathlib import Path

HERE = Path(__file__).parent
PATHS = re.compile(r"/(resources|topics|services|parameters|mappings|aircraft|engine)\b(?!#)")


def test_an_agent_holds_no_path_of_the_server() -> None:
    for agent in ("pilot.py", "wot.mjs", "rules.n3", "reasoner.mjs"):
        assert not PATHS.search((HERE / agent).read_text()), agent
