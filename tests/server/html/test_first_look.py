"""What somebody sees first of a robot that nobody has mapped: values and forms, and RDF for who unfolds it."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import httpx
import pytest

HTML = {"Accept": "text/html"}


@pytest.fixture(scope="module")
def rover(start_server: Callable[..., Any]) -> httpx.Client:
    """A rover without a mapping."""
    http: httpx.Client = start_server("rover").http
    return http


def page(http: httpx.Client, path: str) -> tuple[str, str]:
    """A page: what is seen of it, and what is folded."""
    whole = http.get(path, headers=HTML).text
    seen, fold, folded = whole.partition('<details class="folded">')
    assert fold, path
    return seen, folded


def test_the_entry_page_begins_with_what_there_is_and_folds_its_rdf(rover: httpx.Client) -> None:
    seen, folded = page(rover, "/")
    cards = re.findall(r'<span class="name">([^<]+)</span>', seen)
    assert cards[:4] == ["Resources", "Cockpit", "Diagnostics", "Space"]
    assert "hydra:IriTemplate" in folded
    assert "hydra:IriTemplate" not in seen


def test_the_page_of_a_parameter_shows_its_value_and_folds_its_shape(rover: httpx.Client) -> None:
    seen, folded = page(rover, "/parameters/rover/max_speed")
    assert "From 0.1 to 1.0." in seen
    assert "sh:PropertyShape" not in seen
    assert "sh:PropertyShape" in folded


def test_a_picture_has_no_bytes_in_hexadecimal_beside_it(rover: httpx.Client) -> None:
    seen, _ = page(rover, "/topics/camera/image_raw")
    assert '<figure class="picture">' in seen
    assert ">57,600 bytes</a>" in seen
    assert 'class="hex"' not in seen


def test_a_list_of_topics_says_why_it_has_no_values(rover: httpx.Client) -> None:
    assert "a list subscribes to none" in rover.get("/topics/", headers=HTML).text
    assert "a list subscribes to none" not in rover.get("/services/", headers=HTML).text


def test_what_is_found_has_the_width_of_a_phone(tab: Any, rover: httpx.Client) -> None:
    tab.send("Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=True)
    tab.open(f"{rover.base_url}find?q=battery")
    cells = "[...document.querySelectorAll('.found tbody > tr > *')].filter((each) => each.textContent)"
    assert min(tab.run(f"{cells}.map((each) => each.clientWidth)")) > 330


def test_a_plot_of_what_stands_still_is_as_near_as_its_numbers(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}plot?y=topics/odom%23twist.twist.linear.x")
    of = "((one, other) => chart.scales.y.range(null, one, other))"
    assert tab.run(f"{of}(0, 0)") == [-1, 1]
    assert tab.run(f"{of}(12, 12)") == [10.8, 13.2]
    assert tab.run(f"{of}(null, null)") == [None, None]
    assert tab.run(f"{of}(1, 2)") == pytest.approx([0.9, 2.1])
