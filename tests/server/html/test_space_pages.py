"""Views of space in a real browser: what is drawn, moved and followed, and what is said."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest

CANVAS = "document.querySelector('.space canvas')"
DATA = f"{CANVAS}.dataset"
DARK_PIXELS = f"""(() => {{
  const context = {CANVAS}.getContext('2d'), {{ width, height }} = {CANVAS};
  return context.getImageData(0, 0, width, height).data.filter((each, at) => at % 4 === 0 && each < 60).length;
}})()"""


@pytest.fixture(scope="module")
def rover(start_server: Callable[..., Any]) -> httpx.Client:
    http: httpx.Client = start_server("rover", "--history", "/odom").http
    return http


def test_all_is_drawn_goes_on_and_can_be_hidden_and_followed(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}space")
    tab.until(f"{DATA}.things === '/map /scan /odom' && Number({DATA}.messages) > 20")
    tab.until(f"{DARK_PIXELS} > 2000")
    assert tab.run("document.querySelector('.space [role=status]').textContent") == "Live"
    tab.run("document.querySelector('.legend li:nth-child(2) input').click()")
    tab.until(f"{DATA}.things === '/map /odom'")
    tab.until("document.querySelector('.space select').options.length === 6")
    assert tab.run("[...document.querySelectorAll('.why')].map((each) => each.textContent).join('')") == ""


def test_the_page_of_a_scan_has_its_view_which_lives_with_the_page(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}topics/scan")
    tab.until(f"{DATA}.things === '/scan' && Number({DATA}.messages) > 20")
    assert tab.run("document.querySelectorAll('.space canvas').length") == 1
    assert tab.run("document.querySelector('.space figcaption a').getAttribute('href')") == "/space?show=topics/scan"
