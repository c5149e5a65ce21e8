"""The gallery of sample pages (`gallery.py`) and a real browser (`devtools.py`), for the tests of this folder."""

from __future__ import annotations

import importlib.util
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest


def load(file: str = "gallery") -> ModuleType:
    """A module of this folder: test folders are no packages, so it is loaded from its file."""
    name = f"rosld_page_{file}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{file}.py"))
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


@pytest.fixture(scope="session")
def gallery() -> ModuleType:
    return load()


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
    with load("devtools").browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


@pytest.fixture
def tab(window: Any) -> Iterator[Any]:
    """A tab of its own. Whatever goes wrong in its scripts, or breaks the policy of a page, fails the test."""
    with window.tab() as found:
        yield found
        assert not found.faults, found.faults
