"""N-Triples as text: validated before it goes into an update, and split where it is too large for one request."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

import pyoxigraph

from rosld.server.dataset.base import Edit

_LABEL = re.compile(r'"(?:[^"\\]|\\.)*"|<[^>]*>|_:([^\s.<"]+(?:\.+[^\s.<"]+)*)')


def check_changes(graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> tuple[dict[str, str | None], list[Edit]]:
    """The same change, read and written anew: N-Triples and nothing else, no label of a blank node in two texts.

    ValueError names the first graph whose text is no N-Triples, or whose IRI is none.
    """
    return (
        {name: None if text is None else _again(name, text) for name, text in graphs.items()},
        [Edit(edit.graph, _again(edit.graph, edit.added), _again(edit.graph, edit.removed)) for edit in edits],
    )


def _again(name: str, text: str) -> str:
    graph = pyoxigraph.NamedNode(name)
    if not text:
        return ""
    read = pyoxigraph.Store()
    try:
        read.load(text.encode(), pyoxigraph.RdfFormat.N_TRIPLES)
    except (SyntaxError, UnicodeEncodeError) as error:
        raise ValueError(f"no N-Triples for {graph.value!r}: {error}") from error
    written = read.dump(format=pyoxigraph.RdfFormat.N_TRIPLES, from_graph=pyoxigraph.DefaultGraph())
    assert written is not None
    return written.decode()


def split_parts(text: str, size: int) -> Iterator[str]:
    """The lines in parts of at most about `size` characters; what shares a blank node stays in one part.

    A label means another node in another request, so triples that hang together by blank nodes are never parted: such a
    part may be larger.
    """
    if len(text) <= size:
        yield text
        return
    part: list[str] = []
    filled = 0
    for lines in _together([f"{line}\n" for line in text.split("\n") if line]):
        length = sum(map(len, lines))
        if part and filled + length > size:
            yield "".join(part)
            part, filled = [], 0
        part += lines
        filled += length
    if part:
        yield "".join(part)


def _together(lines: Sequence[str]) -> Iterator[Sequence[str]]:
    """The lines in groups, each of which shares no blank node with another."""
    groups = _Groups()
    joined: dict[str, list[str]] = {}
    for line in lines:
        labels = [match[1] for match in _LABEL.finditer(line) if match[1]]
        if labels:
            groups.join(labels)
            joined.setdefault(labels[0], []).append(line)
        else:
            yield (line,)
    found: dict[str, list[str]] = {}
    for label, held in joined.items():
        found.setdefault(groups.of(label), []).extend(held)
    yield from found.values()


class _Groups:
    """Disjoint sets of labels."""

    def __init__(self) -> None:
        self._above: dict[str, str] = {}

    def of(self, label: str) -> str:
        """The label that stands for its group."""
        above = self._above
        above.setdefault(label, label)
        while above[label] != label:
            above[label] = label = above[above[label]]
        return label

    def join(self, labels: Sequence[str]) -> None:
        """Have these be of one group."""
        first = self.of(labels[0])
        for label in labels[1:]:
            self._above[self.of(label)] = first
