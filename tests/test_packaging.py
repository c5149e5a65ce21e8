"""Content of an installation: a wheel, built from the source distribution, has exactly the files below `rosld`."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

import rosld

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
ROOMS = ("adapters", "ontology", "queries", "server", "shapes")
NOT_COPIED = shutil.ignore_patterns(
    ".git", ".venv*", "build", "dist", "*.egg-info", ".*_cache", "__pycache__", ".hypothesis", "node_modules"
)


def build(what: str, source: Path, target: Path) -> Path:
    """Run a hook of the build backend (PEP 517) and return the path of the created file."""
    target.mkdir()
    code = f"import sys, setuptools.build_meta as b; print(b.build_{what}(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(target)], cwd=source, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return target / done.stdout.strip().splitlines()[-1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of a copy of this tree, built from a source distribution."""
    try:
        if int(version("setuptools").partition(".")[0]) < 77:
            raise PackageNotFoundError
    except PackageNotFoundError:
        pytest.skip("building needs setuptools 77 or newer: pip install 'setuptools>=77'")
    folder = tmp_path_factory.mktemp("packaging")
    shutil.copytree(ROOT, folder / "tree", symlinks=True, ignore=NOT_COPIED)
    with tarfile.open(build("sdist", folder / "tree", folder / "sdist")) as archive:
        archive.extractall(folder / "unpacked")
    unpacked = next((folder / "unpacked").iterdir())
    assert {"tests", "server", "deploy", "docs", "bench", "Makefile", "CHANGELOG.md"} <= {
        path.name for path in unpacked.iterdir()
    }
    return build("wheel", unpacked, folder / "wheel")


def test_the_wheel_holds_every_file_its_license_and_nothing_but_rosld(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {top for name in names if not (top := name.partition("/")[0]).endswith(".dist-info")} == {"rosld"}
    files = {
        f"rosld/{path.relative_to(ROOT)}"
        for room in ROOMS
        for path in (ROOT / room).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".md"
    }
    assert not {"rosld/py.typed", *files} - names
    assert any(name.endswith("/licenses/LICENSE") for name in names)


def test_the_installed_wheel_runs_and_finds_its_data(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    code = (
        "import importlib.resources as r, rosld, rosld.server.cli.main, rosld.adapters.registry; print(rosld.__file__);"
        "assert r.files('rosld.ontology').joinpath('core.ttl').read_bytes()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.startswith(str(tmp_path))


def test_the_version_is_the_same_everywhere() -> None:
    places = {
        "CHANGELOG.md": r"^## \[(\d\S*)\]",
        "deploy/kubernetes.yml": r"image: rosld:(\S+)",
        "deploy/ros2/package.xml": r"<version>(\S+)</version>",
        "deploy/ros2/setup.py": r'version="(\S+)"',
    }
    found = {
        path: re.search(pattern, (ROOT / path).read_text("utf-8"), re.MULTILINE) for path, pattern in places.items()
    }
    assert {path: match and match[1] for path, match in found.items()} == dict.fromkeys(places, rosld.__version__)


def test_the_guide_for_services_shows_the_unit_of_the_package() -> None:
    unit = (ROOT / "deploy" / "rosld.service").read_text("utf-8")
    assert f"```ini\n{unit}```" in (ROOT / "docs" / "how-to" / "service.md").read_text("utf-8")


def test_rosld_runs_in_the_ros_whose_setup_is_named_and_is_not_started_if_that_fails(tmp_path: Path) -> None:
    script = shutil.copy(ROOT / "deploy" / "rosld-ros", tmp_path)
    (tmp_path / "rosld").write_text('#!/bin/sh\necho "$ROS_DISTRO $@"\n')
    (tmp_path / "rosld").chmod(0o755)
    setup = tmp_path / "setup.bash"
    setup.write_text("export ROS_DISTRO=own\n")

    def run(**environment: str) -> str:
        words = [script, "serve", "ros2:?domain=4 2"]
        return subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60, check=False).stdout

    assert run(PATH=os.environ["PATH"], ROSLD_SETUP=str(setup)) == "own serve ros2:?domain=4 2\n"
    assert run(PATH=os.environ["PATH"], AMENT_PREFIX_PATH="/x", ROS_DISTRO="here") == "here serve ros2:?domain=4 2\n"
    assert run(PATH=os.environ["PATH"], ROSLD_SETUP=str(tmp_path / "missing")) == ""
