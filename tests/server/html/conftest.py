"""The gallery of sample pages (`gallery.py`) and a real browser (`devtools.py`), for the tests of this folder."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any

import pytest

import tests.server.html.devtools
import tests.server.html.gallery


@pytest.fixture(scope="session")
def gallery() -> ModuleType:
    return tests.server.html.gallery


@pytest.fixture(scope="session")
def pages(gallery: ModuleType) -> Mapping[str, bytes]:
    """Every sample page by name."""
    found: Mapping[str, bytes] = gallery.gallery()
    return found


@pytest.fixture(scope="session")
def browser() -> None:
    """Skips, by name, what needs chromium where there is none."""
    if not any(map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))):
        pytest.skip("needs chromium: apt-get install $(cat tests/debian-browser.txt)")


@pytest.fixture(scope="session")
def window(browser: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser without a window that lasts; `window.tab()` opens a page in it."""
    with tests.server.html.devtools.browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


@pytest.fixture
def tab(window: Any) -> Iterator[Any]:
    """A tab of its own. Whatever goes wrong in its scripts, or breaks the policy of a page, fails the test."""
    with window.tab() as found:
        yield found
        assert not found.faults, found.faults
