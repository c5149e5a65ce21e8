"""Rendering of graphs as N-Triples for the query process, without blocking the event loop."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Mapping
from typing import TypeAlias

_log = logging.getLogger("rosld.sparql")

INLINE = 64 * 1024
"""Characters of N-Triples up to which graphs are rendered on the loop: a thread would cost more."""
_SLICE = 0.002
"""Seconds of rendering in a thread after which the loop gets its turn: both need the interpreter's lock."""

Renderings: TypeAlias = Mapping[str, Callable[[], str] | None]
"""What renders each graph, by its IRI; None for a graph that goes."""


def render_graphs(graphs: Renderings, slice: float | None = None) -> dict[str, str | None]:
    """The N-Triples of graphs; None for those that go, and for those whose source fails, which is logged.

    With a `slice` (seconds) it pauses for a tenth of that after each. Raises MemoryError.
    """
    texts: dict[str, str | None] = {}
    pause = None if slice is None else time.monotonic() + slice
    for iri, ntriples in graphs.items():
        texts[iri] = None if ntriples is None else _render(iri, ntriples)
        if slice is not None and pause is not None and time.monotonic() > pause:
            time.sleep(slice / 10)
            pause = time.monotonic() + slice
    return texts


async def render_in_thread(graphs: Renderings) -> dict[str, str | None]:
    """`render_graphs` in a thread which lets the loop have its turn. Raises MemoryError."""
    return await asyncio.to_thread(render_graphs, graphs, _SLICE)


def _render(iri: str, ntriples: Callable[[], str]) -> str | None:
    try:
        return ntriples()
    except MemoryError:
        raise
    except Exception:  # a source's failure concerns one graph only
        _log.exception("%s cannot be rendered and is left out of the dataset", iri)
        return None
