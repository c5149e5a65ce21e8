"""Pages on a phone and without JavaScript: looked at with a real browser, where there is one."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from html import unescape
from types import ModuleType
from typing import TypeAlias

import pytest

from rosld.server.html import render_page

WIDTH = 360
MEASURE = """<!doctype html><meta charset="utf-8"><title>measuring</title><body>%s<script>
// What in the header is less than four pixels from something else in it, or reaches beyond the page.
function crowding(page, name) {
  page.querySelector(".brand bdi").textContent = name;
  const live = page.querySelector(".liveness");
  if (live) {
    live.hidden = false;
    live.querySelector("[role=status]").textContent = "Not live";
    live.querySelector("button").textContent = "Pause";
  }
  const words = [...page.querySelectorAll(".brand bdi, .bar nav li, .bar .stop button, .bar .liveness > *")];
  const boxes = words.filter((each) => each.checkVisibility() && each.textContent).map((each) => {
    const range = page.ownerDocument.createRange();
    range.selectNodeContents(each);
    const told = range.getBoundingClientRect(), box = each.matches("button") ? each.getBoundingClientRect() : told;
    return {text: each.textContent, left: box.left, right: box.right, top: box.top, bottom: box.bottom};
  });
  const near = (one, other) => one.left < other.right + 4 && other.left < one.right + 4 &&
    one.top < other.bottom && other.top < one.bottom;
  return boxes.filter((one) => one.right > page.clientWidth || boxes.some((other) => other !== one && near(one, other)))
    .map((one) => `${name}: ${one.text}`);
}
addEventListener("load", () => {
  const found = {};
  for (const frame of document.querySelectorAll("iframe")) {
    const page = frame.contentDocument.documentElement;
    const styled = getComputedStyle(page.querySelector("main")).maxWidth !== "none";
    const small = [...page.querySelectorAll("button, input:not([type=hidden]), select")].filter(
      (each) => each.checkVisibility() && each.getBoundingClientRect().height < 18).length;
    const crowded = ["aircraft", "a-robot-with-a-long-name.example:11311"].flatMap((name) => crowding(page, name));
    found[frame.title] = {width: page.scrollWidth, styled, small, crowded};
  }
  document.body.textContent = JSON.stringify(found);
});
</script>"""


Measured: TypeAlias = Mapping[str, Mapping[str, object]]


@pytest.fixture(scope="module")
def shown(gallery: ModuleType, pages: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """The sample pages, and two with the button that stops the robot."""
    stoppable = {"stoppable": gallery.aircraft_stopped(), "stoppable_topic": gallery.display()}
    drawn = {
        name: render_page(replace(page, site=replace(page.site, stop_token="1795225901.stop")))
        for name, page in stoppable.items()
    }
    return {**pages, **drawn}


@pytest.fixture(scope="module")
def measured(browser: None, gallery: ModuleType, shown: Mapping[str, bytes]) -> Measured:
    """How wide each page gets in a frame of 360 pixels, and whether its stylesheet passed its policy."""
    frames = "".join(f'<iframe title="{name}" src="/{name}" width="{WIDTH}" height="700"></iframe>' for name in shown)
    with gallery.served(shown, {"measure": (MEASURE % frames).encode()}) as url:
        printed = gallery.chromium("--dump-dom", "--virtual-time-budget=20000", f"{url}measure")
    found = re.search(r"<body>(\{.*\})</body>", printed, re.DOTALL)
    assert found, printed[-2000:]
    numbers: Measured = json.loads(unescape(found[1]))
    return numbers


def test_no_page_is_wider_than_a_phone(measured: Measured, shown: Mapping[str, bytes]) -> None:
    assert measured.keys() == shown.keys()
    assert {name: each["width"] for name, each in measured.items()} == dict.fromkeys(shown, WIDTH)


def test_the_stylesheet_passes_the_policy(measured: Measured) -> None:
    assert all(each["styled"] for each in measured.values())


def test_nothing_in_the_header_touches_anything_else_or_reaches_beyond_the_page(measured: Measured) -> None:
    assert {name: each["crowded"] for name, each in measured.items() if each["crowded"]} == {}


def test_nothing_to_press_is_too_small_for_a_finger(measured: Measured) -> None:
    assert not [name for name, each in measured.items() if each["small"]]
