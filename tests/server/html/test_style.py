"""The stylesheet, with readable colours in light and dark mode, and the other files of pages."""

from __future__ import annotations

import re
from importlib.resources import files

from rosld.server.html.frame import ASSETS
from rosld.server.resources.entry_point import FILES

TEXT = ASSETS["style.css"].decode()
LIGHT, DARK = (
    dict(re.findall(r"--(\w[\w-]*): (#[0-9a-f]{6});", block)) for block in re.findall(r":root \{(.*?)\}", TEXT, re.S)
)
ON_GROUND = [
    (ink, ground)
    for ground in ("paper", "card", "wash")
    for ink in ("ink", "quiet", "accent", "bad")
]  # fmt: skip
PAIRS = [*ON_GROUND, ("good", "good-wash"), ("warn", "warn-wash"), ("bad", "bad-wash"), ("on-accent", "accent")]


def luminance(colour: str) -> float:
    """Return the relative luminance of an sRGB colour (WCAG 2.2)."""
    channels = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [each / 12.92 if each <= 0.04045 else ((each + 0.055) / 1.055) ** 2.4 for each in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio (WCAG 2.2), 1 to 21."""
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_text_stands_out_by_at_least_4_5_to_1_and_edges_of_inputs_by_3_to_1() -> None:
    for colours in (LIGHT, DARK):
        assert not [pair for pair in PAIRS if contrast(colours[pair[0]], colours[pair[1]]) < 4.5]
        assert contrast(colours["edge"], colours["paper"]) >= 3
    assert DARK.keys() == LIGHT.keys()


def test_every_class_in_the_stylesheet_is_used_by_a_template() -> None:
    templates = "".join(each.read_text() for each in (files("rosld.server.html") / "templates").iterdir())
    sources = "".join(
        each.read_text()
        for folder in ("html", "html/vendor", "diagrams")
        for each in (files("rosld.server") / folder).iterdir()
        if each.name.endswith((".py", ".js"))
    )
    classes = set(re.findall(r"\.([a-z][a-z-]+)(?=[^{}]*\{)", re.sub(r"/\*.*?\*/|@media[^{]*", "", TEXT, flags=re.S)))
    assert not [name for name in sorted(classes) if not re.search(rf"\b{name}\b", templates + sources)]


def test_each_file_that_a_template_names_is_served_and_no_other_is_read() -> None:
    templates = (each.read_text("utf-8") for each in (files("rosld.server.html") / "templates").iterdir())
    named = {name for text in templates for name in re.findall(r"'(\w+\.(?:js|css|svg))'", text)}
    assert named <= ASSETS.keys() <= FILES.keys()
    assert ASSETS.keys() - named == {"three.js"}  # `space3d.js` imports it
