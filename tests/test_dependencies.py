"""What is imported is declared: a dependency of a dependency may go with any release of that."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ("adapters", "ontology", "queries", "server", "shapes")
NAMES = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "backports": "backports-zstd",
    "jwt": "pyjwt",
    "mcap_ros1": "mcap-ros1-support",
    "re2": "google-re2",
    "ruamel": "ruamel-yaml",
    "xdist": "pytest-xdist",
    "SPARQLWrapper": "sparqlwrapper",
}
"""The distributions that are called otherwise than what they are imported as."""
OF_ROS = re.compile(
    r"rclpy|rospy|roslib|rosservice|actionlib|dynamic_reconfigure|genpy|tf2_py|rosidl_\w+|rcl_interfaces|\w+_(msgs|srvs)"
    r"|rosld_(aircraft|rover)"
)
"""What comes with a ROS, and is imported where there is one."""
OF_LATER_PYTHONS = {"compression", "tomllib"}
OWN = {"rosld", "tests", *(path.stem for path in (ROOT / "bench").glob("*.py"))}


def imported(file: Path) -> Iterator[str]:
    """The first names of all modules that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import):
            yield from (one.name.partition(".")[0] for one in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.partition(".")[0]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "importorskip")):
            first = node.args[0] if node.args else None
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                yield first.value.partition(".")[0]


def normal(name: str) -> str:
    """The name of a distribution as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def declared(*extras: str) -> set[str]:
    """The distributions that rosld with these extras depends on."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    requirements = [*project["dependencies"]]
    for extra in extras:
        requirements += project["optional-dependencies"][extra]
    return {normal(re.split(r"[\[<>=!~; ]", requirement, maxsplit=1)[0]) for requirement in requirements}


def missing(folders: tuple[str, ...], known: set[str], *, leaving: str = "") -> set[str]:
    """What the files of these folders import and nobody declares, with the file; `leaving` one folder out."""
    out = {"nodes", "node_modules", leaving}
    files = [file for folder in folders for file in (ROOT / folder).rglob("*.py") if out.isdisjoint(file.parent.parts)]
    assert files
    return {
        f"{name} in {file.relative_to(ROOT)}"
        for file in files
        for name in imported(file)
        if name not in sys.stdlib_module_names | OF_LATER_PYTHONS | OWN
        and not OF_ROS.fullmatch(name)
        and NAMES.get(name, normal(name)) not in known
    }


@pytest.mark.parametrize(
    ("folders", "extras"),
    [
        (PACKAGE, ("oidc",)),
        (("tests",), ("test",)),
        (("tests/interop",), ("test", "interop")),
        (("bench",), ("test", "bench")),
        (("docs",), ()),
    ],
    ids=["package", "tests", "interop", "bench", "docs"],
)
def test_what_is_imported_is_declared(folders: tuple[str, ...], extras: tuple[str, ...]) -> None:
    leaving = "interop" if folders == ("tests",) else ""
    assert missing(folders, declared(*extras), leaving=leaving) == set()


def test_only_what_asks_for_openid_connect_needs_its_extra() -> None:
    assert missing(PACKAGE, declared()) == {"jwt in server/auth/oidc.py"}
