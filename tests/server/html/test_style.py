"""The stylesheet, with readable colours in light and dark mode, and the other files of pages."""

from __future__ import annotations

import re

from rosld.server.html.frame import ASSETS

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
