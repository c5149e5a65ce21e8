"""Who may import whom, and where things lie: the house as `CONTRIBUTING.md` draws it."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parent.parent
ROOMS = ("adapters", "ontology", "queries", "server", "shapes")
RDF = ("pyoxigraph", "rdflib", "pyshacl")
WEB = ("starlette", "uvicorn", "httptools", "jinja2", "click")

# For each part (the longest that fits): the parts it may import, itself always included.
MAY_IMPORT: dict[str, tuple[str, ...]] = {
    "rosld": ("rosld.server",),
    "rosld.adapters.model": (),
    "rosld.adapters.base": ("rosld.adapters.model",),
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
        "rosld.adapters.registry",
    ),
}
KNOWS_NOTHING_OF: dict[str, tuple[str, ...]] = {
    "rosld.adapters": (*RDF, *WEB),
    "rosld.ontology": WEB,
    "rosld.queries": (*RDF, *WEB),
    "rosld.shapes": WEB,
}


def sources() -> Iterator[tuple[str, Path]]:
    """Every module of rosld by its dotted name."""
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


def imports(path: Path) -> Iterator[str]:
    """The modules a file imports; of `from a import b` it is `a.b` where that is a module of rosld, else `a`."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports are not used here"
            assert node.module is not None
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in modules() else node.module


def within(module: str, part: str) -> bool:
    return module == part or module.startswith(part + ".")


def part_of(module: str, parts: dict[str, tuple[str, ...]]) -> str | None:
    return max((part for part in parts if within(module, part)), key=len, default=None)


def kind_of_adapter(module: str) -> str | None:
    """The kind of system a module is an adapter's part of, None for what all adapters share."""
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
    assert not permitted("rosld.server.http.link", "rosld.server.robot.session")


LAYERS = [
    "cli",
    "app",
    "serving",
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
"""The folders and files of `server/`, from the top: each imports only from those after it."""


def layer_of(module: str) -> int:
    return LAYERS.index(module.split(".")[2])


def test_the_layers_of_the_server_import_downwards_only() -> None:
    """Also under TYPE_CHECKING and within functions: so no two folders import each other."""
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


def test_every_folder_with_an_init_is_packaged() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    folders = {
        module_of(f"rosld/{path.relative_to(ROOT)}") for room in ROOMS for path in (ROOT / room).rglob("__init__.py")
    }
    assert {"rosld", *folders} == set(project["tool"]["setuptools"]["packages"])


@pytest.mark.parametrize("room", ROOMS)
def test_each_room_is_linked_into_the_import_package(room: str) -> None:
    link = ROOT / "rosld" / room
    assert link.is_symlink()
    assert link.readlink() == Path("..") / room
    assert (ROOT / room / "__init__.py").is_file()


def test_tests_are_no_package() -> None:
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
print(*sorted({"PIL", "pyshacl", "rdflib"} & sys.modules.keys()))
"""


def test_a_server_is_made_without_what_it_may_never_need() -> None:
    made = subprocess.run([sys.executable, "-c", _MADE], capture_output=True, text=True, check=True)
    assert made.stdout.strip() == ""


MAX_ATTRIBUTES = 14
RECORDS = {"Goal", "Settings", "Input", "AuditEntry", "Receipt", "Bag"}
"""Plain records: a setting, a form field, a receipt, a recording have as many members as they have."""
STILL_LARGE = {"Mirror", "Client"}
"""Still to be taken apart."""


def attributes(node: ast.ClassDef) -> set[str]:
    """The attributes that a class declares as a record, or assigns to itself."""
    bases = {ast.unparse(base).rpartition(".")[2] for base in node.bases}
    is_record = "NamedTuple" in bases or any("dataclass" in ast.unparse(each) for each in node.decorator_list)
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
    large = {
        node.name
        for path in modules().values()
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ClassDef) and len(attributes(node)) > MAX_ATTRIBUTES
    }
    # Three of a connection's are uvicorn's: parser, expect_100_continue, timeout_keep_alive_task.
    assert large - {"Connection"} == RECORDS | STILL_LARGE
