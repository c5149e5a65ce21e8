"""Builder and installer of a package of ROS 2 interfaces, using only ROS 2's wheels and a C compiler.

    python interfaces.py FOLDER/PACKAGE [msg/NAME.msg ...]

is run by the Python of a venv with the wheels. The folder has definitions in msg/, srv/ and action/; by default all of
them are used. They are generated and compiled as in a build of ROS, and the results are installed into the venv in the
places of ROS: libraries in lib/, definitions in share/, classes in site-packages.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PREFIX = Path(sys.prefix)
SHARE, LIBRARIES = PREFIX / "share", PREFIX / "lib"
NEEDED = (
    "action_msgs",
    "builtin_interfaces",
    "geometry_msgs",
    "service_msgs",
    "std_msgs",
    "unique_identifier_msgs",
)
"""Packages of types within every service and action, or within the definitions of the tests."""
RUNTIME = (
    "fastcdr",
    "rcutils",
    "rmw",
    "rosidl_runtime_c",
    "rosidl_typesupport_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp",
    "rosidl_typesupport_introspection_c",
)
FAST, INTROSPECTION = "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"
MESSAGES, DISPATCH, PYTHON = "rosidl_generator_c", "rosidl_typesupport_c", "rosidl_generator_py"
ORDER = (MESSAGES, FAST, INTROSPECTION, DISPATCH, PYTHON)
"""Libraries of a package, each of which may use the previous ones."""


@dataclass(frozen=True)
class Package:
    """A package under construction: its name, its definitions, and a folder for temporary files.

    If `chosen` is not empty, only these definitions in `source` are used.
    """

    name: str
    source: Path
    work: Path
    chosen: frozenset[str] = frozenset()

    @property
    def share(self) -> Path:
        """Folder for its definitions, including those in IDL and the descriptions of types."""
        return SHARE / self.name

    @property
    def definitions(self) -> Sequence[Path]:
        """The definitions in the source."""
        kinds = ("msg", "srv", "action")
        found = [path for kind in kinds for path in sorted(self.source.glob(f"{kind}/*.{kind}"))]
        return [path for path in found if not self.chosen or path.relative_to(self.source).as_posix() in self.chosen]

    @property
    def idl(self) -> Sequence[str]:
        """The definitions in IDL, below `share`."""
        return [path.relative_to(self.source).with_suffix(".idl").as_posix() for path in self.definitions]

    def generated(self, kind: str) -> Path:
        """Folder for the output of a generator: `#include "PACKAGE/..."` is relative to the folder above."""
        return self.work / kind / self.name


def define(package: Package) -> None:
    """Install the definitions, and their translation to IDL."""
    from rosidl_adapter.action import convert_action_to_idl
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_adapter.srv import convert_srv_to_idl

    convert = {".msg": convert_msg_to_idl, ".srv": convert_srv_to_idl, ".action": convert_action_to_idl}
    for path in package.definitions:
        relative = path.relative_to(package.source)
        folder = package.share / relative.parent
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, folder)
        convert[path.suffix](package.source, package.name, relative, folder)


def run(
    package: Package, kind: str, generate: Callable[..., object], to: Path, *more: object, **changed: object
) -> None:
    """Run a generator, which reads its arguments from a file."""
    templates = SHARE / kind / "resource"
    for header in templates.glob("*visibility_control.h.in"):
        text = header.read_text("utf-8")
        text = text.replace("@PROJECT_NAME_UPPER@", package.name.upper()).replace("@PROJECT_NAME@", package.name)
        (to / "msg").mkdir(parents=True, exist_ok=True)
        (to / "msg" / header.name.removesuffix(".in")).write_text(text, "utf-8")
    orders = package.work / "orders.json"
    foreign = [f"{name}:{path}" for name in NEEDED for path in sorted((SHARE / name).rglob("*.idl"))]
    asked: dict[str, object] = {
        "package_name": package.name,
        "output_dir": str(to),
        "template_dir": str(templates),
        "idl_tuples": [f"{package.share}:{each}" for each in package.idl],
        "ros_interface_dependencies": foreign,
        "target_dependencies": [],
    }
    orders.write_text(json.dumps({**asked, **changed}), "utf-8")
    generate(str(orders), *more)


def generate(package: Package, classes: Path) -> None:
    """Write the descriptions of the types, the C and C++ of every library, and the Python classes."""
    from rosidl_generator_c import generate_c as messages
    from rosidl_generator_py import generate_py as python
    from rosidl_generator_type_description import generate_type_hash as describe
    from rosidl_typesupport_c import generate_c as dispatch
    from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c as fast
    from rosidl_typesupport_introspection_c import generate_c as introspection

    others = [f"{name}:{SHARE / name}" for name in NEEDED]
    run(package, "rosidl_generator_type_description", describe, package.share, include_paths=others)
    described = [f"{each}:{(package.share / each).with_suffix('.json')}" for each in package.idl]
    sources = list(map(str, package.definitions))
    to = package.generated
    run(package, MESSAGES, messages, to(MESSAGES), type_description_tuples=described, ros_interface_files=sources)
    run(package, FAST, fast, to(FAST))
    run(package, INTROSPECTION, introspection, to(INTROSPECTION))
    run(package, DISPATCH, dispatch, to(DISPATCH), [FAST, INTROSPECTION])
    run(package, PYTHON, python, classes, [DISPATCH])
    (classes / "__init__.py").touch()


def told(command: Sequence[str]) -> None:
    """Run a compiler without access to the libraries of ROS. Raises SystemExit with its output."""
    hidden = ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{command[0]} {command[-1]}:\n{done.stderr[:3000]}")


def compile_all(package: Package, classes: Path) -> Mapping[str, Sequence[Path]]:
    """Return the objects of each library, and of the extension module as `extension`."""
    import numpy

    includes = [package.generated(kind).parent for kind in (MESSAGES, FAST, INTROSPECTION)]
    includes += [PREFIX / "include", *(each for each in (PREFIX / "include").iterdir() if each.is_dir())]
    includes += [Path(sysconfig.get_path("include")), Path(numpy.get_include())]
    entry = classes / f"_{package.name}_s.ep.{DISPATCH}.c"
    sources = {
        MESSAGES: package.generated(MESSAGES).rglob("*.c"),
        FAST: package.generated(FAST).rglob("*.cpp"),
        INTROSPECTION: package.generated(INTROSPECTION).rglob("*.c"),
        DISPATCH: package.generated(DISPATCH).rglob("*.cpp"),
        PYTHON: classes.rglob("*_s.c"),
        "extension": [entry],
    }

    def compiled(job: tuple[str, int, Path]) -> tuple[str, Path]:
        library, number, source = job
        made = package.work / f"{library}.{number}.o"
        language = ("gcc", "-std=gnu11") if source.suffix == ".c" else ("g++", "-std=c++17")
        found = [f"-I{each}" for each in includes]
        told([*language, "-O0", "-w", "-fPIC", *found, "-c", "-o", str(made), str(source)])
        return library, made

    jobs = [(library, number, path) for library, paths in sources.items() for number, path in enumerate(sorted(paths))]
    objects: dict[str, list[Path]] = {library: [] for library in sources}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for library, made in pool.map(compiled, jobs):
            objects[library].append(made)
    return objects


def linked(path: Path, objects: Iterable[Path], needed: Iterable[str]) -> None:
    """Link a library, which loads these."""
    runs = ["-Wl,-rpath,$ORIGIN", "-Wl,--as-needed", "-Wl,--allow-shlib-undefined", f"-Wl,-soname,{path.name}"]
    names = [f"-l{each}" for each in needed]
    told(["g++", "-shared", *runs, *map(str, objects), f"-L{LIBRARIES}", *names, "-o", str(path)])


def link_all(package: Package, objects: Mapping[str, Sequence[Path]], classes: Path) -> None:
    """Install the libraries, each linked to the previous ones, to those of the needed packages, and to ROS's own."""
    before: list[str] = []
    for kind in ORDER:
        others = [f"{name}__{each}" for name in NEEDED for each in dict.fromkeys((kind, MESSAGES))]
        own = f"{package.name}__{kind}"
        linked(LIBRARIES / f"lib{own}.so", objects[kind], [*before, *others, *RUNTIME])
        before.append(own)
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    others = [f"{name}__{kind}" for name in NEEDED for kind in (DISPATCH, PYTHON, MESSAGES)]
    extension = classes / f"{package.name}_s__{DISPATCH}{suffix}"
    linked(extension, objects["extension"], [*before, *others, *RUNTIME])


def register(package: Package) -> None:
    """Register the package and its interfaces in ament's index, like an installed package of ROS."""
    index = SHARE / "ament_index" / "resource_index"
    (index / "packages" / package.name).touch()
    lines = [path.relative_to(package.source).as_posix() for path in package.definitions]
    (index / "rosidl_interfaces" / package.name).write_text("\n".join([*lines, *package.idl]), "utf-8")


def install(source: Path, *chosen: str) -> None:
    """Build the package whose definitions are in a folder of its name, and install it into this venv."""
    if not re.fullmatch(r"[a-z]\w*", source.name) or not any(source.glob("*/*.*")):
        raise SystemExit(f"{source} is no folder of a package with msg/, srv/ or action/ in it")
    os.environ["AMENT_PREFIX_PATH"] = str(PREFIX)
    paths: Mapping[str, Any] = sysconfig.get_paths()
    with tempfile.TemporaryDirectory(dir=PREFIX) as folder:
        package = Package(source.name, source.resolve(), Path(folder), frozenset(chosen))
        classes = package.work / package.name
        define(package)
        generate(package, classes)
        link_all(package, compile_all(package, classes), classes)
        installed = Path(paths["platlib"]) / package.name
        shutil.rmtree(installed, ignore_errors=True)
        classes.rename(installed)
        register(package)


if __name__ == "__main__":
    install(Path(sys.argv[1]), *sys.argv[2:])
