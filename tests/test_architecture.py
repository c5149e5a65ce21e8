"""Imports of modules and distributions by each part, and places of files, according to `CONTRIBUTING.md`."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
ROOMS = ("adapters", "ontology", "queries", "server", "shapes")
RDF = ("pyoxigraph", "rdflib", "pyshacl")
WEB = ("starlette", "uvicorn", "httptools", "jinja2", "click")

# For each part (the longest that fits): the parts it may import, itself always included.
MAY_IMPORT: dict[str, tuple[str, ...]] = {
    "rosld": ("rosld.server",),
    "rosld.adapters.model": (),
    "rosld.adapters.catalogue": ("rosld.adapters.model",),
    "rosld.adapters.base": ("rosld.adapters.model", "rosld.adapters.catalogue"),
    "rosld.adapters": ("rosld.adapters",),
    "rosld.ontology": ("rosld.adapters.model",),
    "rosld.queries": (),
    "rosld.shapes": ("rosld.ontology", "rosld.adapters.model"),
    "rosld.server.http": ("rosld.ontology", "rosld.shapes"),
    "rosld.server": (
        "rosld",
        "rosld.queries",
        "rosld.shapes",
        "rosld.ontology",
        "rosld.adapters.model",
        "rosld.adapters.base",
        "rosld.adapters.catalogue",
        "rosld.adapters.registry",
    ),
}
KNOWS_NOTHING_OF: dict[str, tuple[str, ...]] = {
    "rosld.adapters": (*RDF, *WEB),
    "rosld.ontology": WEB,
    "rosld.queries": (*RDF, *WEB),
    "rosld.shapes": WEB,
}


BLOCKS = (ast.stmt, ast.excepthandler, ast.match_case)
"""Nodes within which imports are searched: walking expressions takes ten times as long."""


def sources() -> Iterator[tuple[str, Path]]:
    """Yield every module of rosld by its dotted name."""
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            yield module_of(f"rosld/{path.relative_to(ROOT)}"), path
    for path in sorted((ROOT / "rosld").glob("*.py")):
        yield module_of(str(path.relative_to(ROOT))), path


def module_of(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


@cache
def modules() -> dict[str, Path]:
    return dict(sources())


class Facts(NamedTuple):
    """Imported modules of a file, and the names of its classes with too many attributes."""

    imports: set[str]
    large_classes: set[str]


@cache
def facts(path: Path) -> Facts:
    """Parse a file once for all tests; of `from a import b` the import is `a.b` where that is a module of rosld."""
    text = path.read_text("utf-8")
    found = Facts(set(re.findall(r"(?:import_module|importorskip)\(\s*\"([\w.]+)", text)), set())
    waiting: list[ast.AST] = [ast.parse(text)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            found.imports.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports are not used here"
            assert node.module is not None
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.imports.add(inner if inner in modules() else node.module)
        else:
            waiting += (each for each in ast.iter_child_nodes(node) if isinstance(each, BLOCKS))
            if isinstance(node, ast.ClassDef) and len(attributes(node)) > MAX_ATTRIBUTES:
                found.large_classes.add(node.name)
    return found


def imports(path: Path) -> set[str]:
    return facts(path).imports


def within(module: str, part: str) -> bool:
    return module == part or module.startswith(part + ".")


def part_of(module: str, parts: dict[str, tuple[str, ...]]) -> str | None:
    return max((part for part in parts if within(module, part)), key=len, default=None)


def kind_of_adapter(module: str) -> str | None:
    """Return the kind of system of a module in an adapter, None for those shared by all adapters."""
    names = module.split(".")
    if names[:2] != ["rosld", "adapters"] or len(names) < 3 or names[2] == "model":
        return None
    return names[2] if (ROOT / "adapters" / names[2]).is_dir() else None


def permitted(importer: str, imported: str) -> bool:
    part = part_of(importer, MAY_IMPORT)
    assert part is not None
    if imported == "rosld":
        return part in ("rosld", "rosld.server")
    if kind_of_adapter(imported) is not None:
        return kind_of_adapter(imported) == kind_of_adapter(importer)
    if kind_of_adapter(importer) is not None and imported == "rosld.adapters.registry":
        return False
    return within(imported, part) or any(within(imported, other) for other in MAY_IMPORT[part] if other != "rosld")


def test_imports_go_downwards_only() -> None:
    forbidden = {
        (module, name)
        for module, path in modules().items()
        for name in imports(path)
        if within(name, "rosld") and not permitted(module, name)
    }
    assert not forbidden


def test_adapters_know_no_rdf_and_meaning_knows_no_web() -> None:
    foreign = {
        (module, name)
        for module, path in modules().items()
        if (part := part_of(module, KNOWS_NOTHING_OF))
        for name in imports(path)
        if name.partition(".")[0] in KNOWS_NOTHING_OF[part]
    }
    assert not foreign


def test_the_directions_are_really_held() -> None:
    assert permitted("rosld.server.app", "rosld.adapters.base")
    assert permitted("rosld.adapters.ros1.master", "rosld.adapters.model.graph")
    assert not permitted("rosld.server.app", "rosld.adapters.aircraft")
    assert not permitted("rosld.adapters.ros1", "rosld.adapters.recording.bag")
    assert not permitted("rosld.adapters.ros1", "rosld.adapters.registry")
    assert not permitted("rosld.adapters.model.graph", "rosld.adapters.base")
    assert not permitted("rosld.ontology.lift", "rosld.shapes")
    assert not permitted("rosld.ontology.lift", "rosld.adapters.base")
    assert not permitted("rosld.server.http.fields", "rosld.server.robot.session")


LAYERS = [
    "cli",
    "robots",
    "app",
    "serving",
    "foxglove",
    "mcp",
    "middleware",
    "routing",
    "openapi",
    "resources",
    "events",
    "policies",
    "patches",
    "sparql",
    "rest",
    "html",
    "diagrams",
    "search",
    "hypermedia",
    "robot",
    "history",
    "space",
    "pictures",
    "dataset",
    "receipts",
    "storage",
    "auth",
    "runtime",
    "settings",
    "http",
]
"""Folders and files of `server/`, from the top: each imports only from those after it."""


def layer_of(module: str) -> int:
    return LAYERS.index(module.split(".")[2])


def test_the_layers_of_the_server_import_downwards_only() -> None:
    """This includes TYPE_CHECKING and functions: so no two folders import each other."""
    upwards = {
        (module, name)
        for module, path in modules().items()
        if within(module, "rosld.server") and module != "rosld.server"
        for name in imports(path)
        if within(name, "rosld.server") and layer_of(name) < layer_of(module)
    }
    assert not upwards


def test_every_part_of_the_server_is_in_a_folder() -> None:
    assert {path.name for path in (ROOT / "server").glob("*.py")} == {"__init__.py", "app.py", "settings.py"}
    assert {path.parent.name for path in (ROOT / "server").glob("*/__init__.py")} | {"app", "settings"} == set(LAYERS)


def test_each_folder_is_linked_into_the_import_package_and_tests_are_no_package() -> None:
    for room in ROOMS:
        if not (ROOT / "PKG-INFO").exists():  # the source distribution has copies
            assert (ROOT / "rosld" / room).readlink() == Path("..") / room
        assert (ROOT / room / "__init__.py").is_file()
    assert not list((ROOT / "tests").rglob("__init__.py"))


def test_no_file_is_called_by_a_word_that_says_nothing() -> None:
    empty = {"utils", "util", "helpers", "helper", "manager", "misc", "common"}
    assert not {module for module in modules() if empty & set(module.split("."))}


_MADE = """
import sys
from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from rosld.server.app import create_app
from rosld.server.settings import Settings
create_app(adapter_for("aircraft", AdapterOptions()), Settings())
optional = {"PIL", "markdown_it", "mcp", "opentelemetry"}
optional |= {"prometheus_client", "pyarrow", "pydantic", "pyshacl", "rdflib"}
print(*sorted(optional & sys.modules.keys()))
"""


def test_creating_a_server_imports_none_of_the_libraries_it_may_never_need() -> None:
    made = subprocess.run([sys.executable, "-c", _MADE], capture_output=True, text=True, check=True)
    assert made.stdout.strip() == ""


MAX_ATTRIBUTES = 14
RECORDS = {"Goal", "Settings", "Input", "AuditEntry", "Receipt", "Bag", "Row", "Page", "Group"}
"""Plain records, such as a setting, a page, a receipt or a recording, which have any number of members."""
STILL_LARGE = {"Mirror", "Client"}
"""Classes still to be split."""


def attributes(node: ast.ClassDef) -> set[str]:
    """Return the attributes that a class declares as a record, or assigns to itself."""
    bases = {ast.unparse(base).rpartition(".")[2] for base in node.bases}
    is_record = bases & {"NamedTuple", "Struct"} or any("dataclass" in ast.unparse(one) for one in node.decorator_list)
    declared = {
        each.target.id
        for each in node.body
        if is_record and isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name)
        if "ClassVar" not in ast.unparse(each.annotation)
    }
    assigned = {
        each.attr
        for each in ast.walk(node)
        if isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store)
        if isinstance(each.value, ast.Name) and each.value.id == "self"
    }
    return declared | assigned


def test_no_class_has_more_than_fourteen_attributes_of_its_own() -> None:
    large = set().union(*(facts(path).large_classes for path in modules().values()))
    # Three of a connection's are uvicorn's: parser, expect_100_continue, timeout_keep_alive_task.
    assert large - {"Connection"} == RECORDS | STILL_LARGE


NAMES = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "foxglove": "foxglove-sdk",
    "backports": "backports-zstd",
    "jwt": "pyjwt",
    "markdown_it": "markdown-it-py",
    "opentelemetry": "opentelemetry-sdk",
    "mcap_ros1": "mcap-ros1-support",
    "re2": "google-re2",
    "ruamel": "ruamel-yaml",
    "xdist": "pytest-xdist",
    "zenoh": "eclipse-zenoh",
    "pamoja": "pamoja-ros2",
    "SPARQLWrapper": "sparqlwrapper",
}
"""Distributions whose name differs from that of their module."""
OF_ROS = re.compile(
    r"rclpy|rospy|roslib|rosservice|actionlib|dynamic_reconfigure|genpy|tf2_py|rosidl_\w+|rcl_interfaces|\w+_(msgs|srvs)"
    r"|rosld_(aircraft|rover)"
)
"""Modules that are part of a ROS."""
OF_LATER_PYTHONS = {"compression", "tomllib"}
OWN = {"rosld", "tests", *(path.stem for path in (ROOT / "bench").glob("*.py"))}


def declared(*extras: str) -> set[str]:
    """Return the distributions that rosld with these extras depends on."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    requirements = [*project["dependencies"]]
    for extra in extras:
        requirements += project["optional-dependencies"][extra]
    return {normal(re.split(r"[\[<>=!~; ]", requirement, maxsplit=1)[0]) for requirement in requirements}


def normal(name: str) -> str:
    """Normalize the name of a distribution as indexes do."""
    return re.sub(r"[-_.]+", "-", name).lower()


def undeclared(folders: tuple[str, ...], known: set[str], *, excluded: str = "") -> set[str]:
    """Return the imports of the files in these folders that are not declared, each with its file."""
    out = {"nodes", "node_modules", excluded}
    files = [file for folder in folders for file in (ROOT / folder).rglob("*.py") if out.isdisjoint(file.parent.parts)]
    assert files
    return {
        f"{name} in {file.relative_to(ROOT)}"
        for file in files
        for name in {module.partition(".")[0] for module in imports(file)}
        if name not in sys.stdlib_module_names | OF_LATER_PYTHONS | OWN
        and not OF_ROS.fullmatch(name)
        and NAMES.get(name, normal(name)) not in known
    }


def test_every_imported_distribution_is_declared_and_only_some_features_need_extras() -> None:
    """A dependency of a dependency may go with any of its releases."""
    files = ("cli/mcp", "mcp/prompts", "mcp/protocol", "mcp/subscriptions", "mcp/tools")
    assert undeclared(ROOMS, declared()) == {
        "distributed in server/cli/workers.py",
        "fsspec in server/cli/recording_inputs.py",
        "jwt in server/auth/oidc.py",
        "opentelemetry in server/runtime/tracing.py",
        "pyarrow in server/cli/export.py",
        "xxhash in adapters/ros2/zenoh_participant.py",
        "zenoh in adapters/ros2/zenoh_participant.py",
        *(
            f"pyarrow in server/{file}.py"
            for file in ("history/message_columns", "history/table_files", "history/tables", "sparql/result_tables")
        ),
        *(f"mcp in server/{file}.py" for file in files),
    }
    assert not undeclared(ROOMS, declared("oidc", "mcp", "dask", "files", "otel", "parquet", "zenoh"))
    assert not undeclared(("tests",), declared("test", "parquet", "zenoh"), excluded="interop")
    assert not undeclared(("tests/interop",), declared("test", "interop", "parquet", "dask", "files", "otel"))
    assert not undeclared(("bench",), declared("test", "bench"))
    assert not undeclared(("docs",), declared())
