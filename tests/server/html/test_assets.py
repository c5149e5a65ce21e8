"""The files that pages are drawn with."""

from __future__ import annotations

import re
from importlib.resources import files

from rosld.server.html import ASSETS
from rosld.server.resources.static_assets import FILES


def test_each_file_that_a_template_names_is_served_and_no_other_is_read() -> None:
    templates = (each.read_text("utf-8") for each in (files("rosld.server.html") / "templates").iterdir())
    named = {name for text in templates for name in re.findall(r"'(\w+\.(?:js|css|svg))'", text)}
    assert named <= ASSETS.keys() <= FILES.keys()
    assert ASSETS.keys() - named == {"three.js"}  # `space3d.js` imports it
