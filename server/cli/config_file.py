"""Settings outside the command line: the file of `--config` and the environment, with the place of each for errors."""

from __future__ import annotations

import difflib
import os
import re
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click
from click.core import ParameterSource

from rosld.adapters.registry import RECORDING, installed, scheme_of
from rosld.server import settings as declared
from rosld.server.cli.failure import ExitCode, Failure
from rosld.server.settings import Declaration

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SOURCE, ROBOTS = "source", "robots"
_META = "rosld.config"
_IN_MESSAGE = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)")
_HEADER = re.compile(r"""\s*\[\s*["']?([\w-]+)["']?\s*\]""")
_KEY = re.compile(r"""\s*(?:([\w-]+)|"([^"]*)"|'([^']*)')\s*=\s*""")
_SUBJECT = re.compile(r"(?:--setting |the setting |--)([a-z][a-z_-]*)")
"""Beginning of a message of `Settings`: an option or the name of a setting."""
_SCALARS: Mapping[str, tuple[Any, str]] = {
    "bool": (bool, "true or false"),
    "int": (int, "a whole number"),
    "float": ((int, float), "a number"),
}
_WORDS = {bool: "boolean", int: "number", float: "number", str: "string", list: "list", dict: "table"}
_SIMILAR = 0.8
_OTHER_VARIABLES = {"ROSLD_SOURCE", "ROSLD_CONFIG", "ROSLD_TOKEN", "ROSLD_PRIVATE_NAMESPACE"}


class ConfigFile(NamedTuple):
    """Values by the name of their parameter, and places by key: the line, the columns of the key and of the value."""

    path: Path
    values: Mapping[str, Any]
    places: Mapping[str, tuple[int, int, int]]

    def where(self, name: str, *, key: bool = False) -> str:
        """Return the place of a value or of its key for messages, such as `rosld.toml:3:8`."""
        line, first, second = self.places.get(name, (1, 1, 1))
        return f"{self.path}:{line}:{first if key else second}"


def variable(name: str) -> str:
    """Return the environment variable of a setting."""
    return f"ROSLD_{name.upper()}"


def load(context: click.Context, parameter: click.Parameter, path: Path | None) -> None:
    """Make the values of the file the defaults of a command, and name the file on stderr. Raises Failure."""
    if path is not None and not context.resilient_parsing:
        config = context.meta[_META] = read(path)
        context.default_map = dict(config.values)
        click.echo(f"rosld: settings from {path.resolve()}", err=True)


def read(path: Path) -> ConfigFile:
    """Return the settings in a file. Raises Failure with the file, the line and the column of what is wrong."""
    try:
        text = path.read_bytes().decode("utf-8")
        content = tomllib.loads(text)
    except OSError as error:
        raise Failure(f"{path}: {error.strerror or error}", ExitCode.INPUT) from error
    except UnicodeDecodeError as error:
        raise Failure(f"{path}: not UTF-8 at byte {error.start}", ExitCode.USAGE) from error
    except tomllib.TOMLDecodeError as error:
        at = _IN_MESSAGE.search(str(error))
        line, column = at.groups() if at and at[1] else (text.count("\n") + 1, len(text) - text.rfind("\n"))
        words = _IN_MESSAGE.sub("", str(error))
        raise Failure(f"{path}:{line}:{column}: {words[:1].lower()}{words[1:]}", ExitCode.USAGE) from error
    config = ConfigFile(path, {}, _places(text))
    names = {one.name: one for one in declared.declarations()}
    values: dict[str, Any] = {}
    for name, found in content.items():
        try:
            if name in (SOURCE, ROBOTS):
                values.setdefault(SOURCE, []).extend(_sources(name, found, path.parent))
            elif name in names:
                values[name] = _value(names[name], found, path.parent)
            else:
                place, near = config.where(name, key=True), _nearest(name, [*names, SOURCE, ROBOTS])
                raise Failure(f"{place}: {name} is not a setting{near}", ExitCode.USAGE)
        except ValueError as error:
            raise Failure(f"{config.where(name)}: {name} {error}", ExitCode.USAGE) from error
    if SOURCE in content and ROBOTS in content:
        raise Failure(f"{config.where(SOURCE)}: give either source or [robots]", ExitCode.USAGE)
    return config._replace(values=values)


def _places(text: str) -> dict[str, tuple[int, int, int]]:
    """Return where top-level keys and tables are, which tomllib does not say."""
    found: dict[str, tuple[int, int, int]] = {}
    in_table = False
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            in_table = True
            found.setdefault(header[1], (number, header.start(1) + 1, header.start(1) + 1))
        elif not in_table and (key := _KEY.match(line)):
            name = key[1] or key[2] or key[3] or ""
            found.setdefault(name, (number, line.index(name) + 1, key.end() + 1))
    return found


def _nearest(name: str, names: Iterable[str]) -> str:
    close = difflib.get_close_matches(name.replace("-", "_"), [*names], 1)
    return f": did you mean {close[0]}?" if close else "; rosld serve --help and docs/reference/settings.md list them"


def _value(one: Declaration, found: object, folder: Path) -> object:
    """Return a value for the parameter of a setting; paths are relative to the folder. Raises ValueError."""
    is_path = "Path" in one.type
    if one.type.startswith("tuple"):
        items = [found] if isinstance(found, str) else found
        if not isinstance(items, list) or not all(isinstance(each, str) for each in items):
            raise _wrong("a list of strings", found)
        return [str(folder / each) if is_path else each for each in items]
    accepted, expected = _SCALARS.get(one.type, (str, "a string"))
    if not isinstance(found, accepted) or (isinstance(found, bool) and accepted is not bool):
        raise _wrong(expected, found)
    return str(folder / str(found)) if is_path else found


def _sources(name: str, found: object, folder: Path) -> list[str]:
    """Return the sources of `source` or of the table `robots`. Raises ValueError."""
    if name == SOURCE:
        items = [found] if isinstance(found, str) else found
        if not isinstance(items, list) or not items or not all(isinstance(each, str) and each for each in items):
            raise _wrong("a source, or a list of recordings and folders", found)
        return [_source(each, folder) for each in items]
    if not isinstance(found, dict) or not all(isinstance(each, str) and each for each in found.values()):
        raise ValueError('must be a table of sources, such as arm = "ros1://arm:11311"')
    return [f"{robot}={_source(each, folder)}" for robot, each in found.items()]


def _source(source: str, folder: Path) -> str:
    """Return a source, in which the path of a recording is relative to the folder."""
    schemes = frozenset(installed())
    is_path = scheme_of(source, schemes) == RECORDING and not source.startswith(f"{RECORDING}:")
    return str(folder / source) if is_path else source


def _wrong(expected: str, found: object) -> ValueError:
    shown = repr(found) if isinstance(found, (str, list, dict)) else str(found).lower()
    return ValueError(f"must be {expected}, not the {_WORDS.get(type(found), 'value')} {shown[:100]}")


def others_given(context: click.Context) -> dict[str, str]:
    """Return the settings without an option that the environment or the file gives, as texts by name."""
    config = context.meta.get(_META)
    found = {} if config is None else {**config.values}
    plain = [one.name for one in declared.declarations() if one.option is None]
    found |= {name: os.environ[variable(name)] for name in plain if variable(name) in os.environ}
    return {name: str(found[name]) for name in plain if name in found}


def place_of(context: click.Context, name: str, given: Iterable[str] = ()) -> str:
    """Return the place of a setting that the command line does not give, for the beginning of a message; else ''."""
    source, config = context.get_parameter_source(name), context.meta.get(_META)
    if name in given or source in (ParameterSource.COMMANDLINE, ParameterSource.DEFAULT):
        return ""
    if variable(name) in os.environ:
        return f"{variable(name)}: "
    return f"{config.where(name)}: " if config is not None and name in config.values else ""


def located(context: click.Context, message: str, given: Iterable[str]) -> str:
    """Return a message of `Settings` with the place of the setting that it begins with."""
    match = _SUBJECT.match(message)
    for one in declared.declarations() if match else ():
        if match and match[1] in (one.name, (one.option or "").removeprefix("--")):
            place = place_of(context, one.name, given)
            return f"{place}{one.name}{message[match.end() :]}" if place else message
    return message


def warn_of_variables() -> None:
    """Name on stderr the variables of the environment that are nearly those of settings."""
    known = {variable(one.name) for one in declared.declarations()} | _OTHER_VARIABLES
    for name in sorted(os.environ):
        if name.startswith("ROSLD_") and name not in known:
            for close in difflib.get_close_matches(name, known, 1, _SIMILAR):
                click.echo(f"rosld: {name} is not a setting: did you mean {close}?", err=True)
