"""The pages of real servers, malicious ones and a real browser (`devtools.py`), for the tests of this folder."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

import tests.server.html.devtools
from rosld.server.html.render import render_page
from tests.server.html.hostile_pages import hostile_offer, hostile_page
from tests.server.html.real_pages import real_pages


@pytest.fixture(scope="session")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, bytes]:
    """Every page by name."""
    hostile = {"hostile": hostile_page(), "hostile_offer": hostile_offer()}
    return {
        **real_pages(tmp_path_factory.mktemp("limits")),
        **{name: render_page(page) for name, page in hostile.items()},
    }


@pytest.fixture(scope="session")
def browser() -> None:
    """Skip, by name, tests that need chromium if it is missing."""
    if not any(map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))):
        pytest.skip("needs chromium: apt-get install $(cat tests/debian-browser.txt)")


@pytest.fixture(scope="session")
def window(browser: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A headless browser shared by tests; `window.tab()` opens a page in it."""
    with tests.server.html.devtools.browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


@pytest.fixture
def tab(window: Any) -> Iterator[Any]:
    """A new tab. Script errors and violations of the page's policy fail the test."""
    with window.tab() as found:
        yield found
        assert not found.faults, found.faults
