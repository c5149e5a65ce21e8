"""The gallery of sample pages (`gallery.py`), for the tests of this folder."""

from __future__ import annotations

import importlib.util
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import pytest


def load() -> ModuleType:
    """The gallery as a module: test folders are no packages, so it is loaded from its file."""
    name = "rosld_page_gallery"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name("gallery.py"))
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
