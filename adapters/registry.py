"""Finding the adapter for a source: by its scheme, among the entry points of `rosld.adapters`.

`aircraft` and `ros1://host:11311` name their adapter; anything else is the path of a recording.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import cast

from rosld.adapters.base import Adapter, AdapterOptions, Diagnose, Factory

GROUP = "rosld.adapters"
RECORDING = "recording"
_NAMED = re.compile(r"([A-Za-z0-9][A-Za-z0-9_.-]*)=(.+)", re.DOTALL)
_SCHEME = re.compile(r"([a-z][a-z0-9+.-]+):(?!\\)")


def scheme_of(source: str, schemes: frozenset[str]) -> str:
    """Return the scheme of a source: a bare adapter name, `scheme:...` of a known scheme, else a recording's path.

    Raises ValueError for `scheme://...` whose scheme is not among `schemes`.
    """
    if source in schemes:
        return source
    match = _SCHEME.match(source)
    if match and match[1] in schemes:
        return match[1]
    if match and source[match.end() :].startswith("//"):
        names = ", ".join(sorted(schemes))
        raise ValueError(f"no adapter for {match[1]!r} in {without_credentials(source)!r}; installed: {names}")
    return RECORDING


def without_credentials(source: str) -> str:
    """Return a source for messages and pages: without the user and the password of its URL."""
    return re.sub(r"(?<=//)\S*@", "", source)


def named_sources(words: Sequence[str]) -> Mapping[str, str] | None:
    """Return the sources of several robots, written as `NAME=SOURCE`, by name; None if no word is one.

    An existing file of that name is a recording. Raises ValueError for a mixture, and for a name used twice.
    """
    found = [(None if Path(word).exists() else _NAMED.fullmatch(word), word) for word in words]
    if not any(match for match, _ in found):
        return None
    sources: dict[str, str] = {}
    for match, word in found:
        if match is None:
            shown = without_credentials(word)
            raise ValueError(f"{shown!r} must be NAME=SOURCE, like the others: with several robots each has a name")
        if match[1] in sources:
            raise ValueError(f"two robots are named {match[1]!r}")
        sources[match[1]] = match[2]
    return sources


def joined(sources: Sequence[str]) -> str:
    """Return one source, or several recordings or named robots as one source: a line each.

    Raises ValueError for several others.
    """
    if named_sources(sources) is not None:
        return "\n".join(sources)
    if len(sources) == 1:
        return sources[0]
    schemes = frozenset(installed())
    other = next((each for each in sources if scheme_of(each, schemes) != RECORDING), None)
    if other is not None:
        shown = without_credentials(other)
        raise ValueError(f"{shown!r} is not a recording: several sources must all be recordings or folders of them")
    return f"{RECORDING}:" + "\n".join(each.removeprefix(f"{RECORDING}:") for each in sources)


@cache
def installed() -> Mapping[str, EntryPoint]:
    """Return the installed adapters by scheme. Reading them takes 25 ms."""
    return {point.name: point for point in entry_points(group=GROUP)}


def adapter_for(source: str, options: AdapterOptions) -> Adapter:
    """Return the adapter of a source, not yet open. Raises ValueError with a sentence for the user."""
    points = installed()
    scheme = scheme_of(source, frozenset(points))
    if scheme not in points:
        raise ValueError(f"no adapter {scheme!r} is installed; is rosld installed with pip?")
    factory = cast(Factory, points[scheme].load())
    return factory(source, options)


def diagnosis_of(source: str) -> Diagnose | None:
    """Return the checks of an adapter's package for its sources (`diagnosis.diagnose`), None for most."""
    points = installed()
    scheme = scheme_of(source, frozenset(points))
    name = f"{points[scheme].module}.diagnosis"
    try:
        return cast(Diagnose, importlib.import_module(name).diagnose)
    except ModuleNotFoundError as error:
        if error.name is None or not name.startswith(error.name):
            raise
        return None
