"""Records as named graphs: changes of graphs, derived from the changed records only.

A container may have very many members, so a change of one member never resends the container's graph: only the
member's own triples (containment, membership) are added or removed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeAlias

from pyoxigraph import Triple

from rosld.ontology.document import Document
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.ontology.vocab import dcterms, ldp
from rosld.server.dataset import Edit
from rosld.server.rest.interaction import member_derived_uris, membership_declaration
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.stored_sync import Changes
from rosld.server.storage.record import Member, Membership, Model, Record, RecordChange, RecordWrite, container_of
from rosld.server.storage.record_documents import (
    META,
    client_ntriples,
    managed_triples,
    record_document,
    unpacked_size,
    without_statements,
)
from rosld.server.storage.sqlite import Records

_PAGE = 200
"""Number of changed records processed before yielding to the loop: some milliseconds."""
_MORE = 20
"""Maximum number of additional pages for changes made during a search."""
_MEMBERS = 1000
"""Number of members listed before yielding to the loop."""
_ROBOTS = frozenset({"topics", "parameters", "resources", "nodes", "services", "actions"})
"""Routes without stored resources."""
_OVERHEAD = 600
"""Approximate number of characters that the server adds to the statements of a record."""


ExtraTriples: TypeAlias = Callable[[Record], Sequence[Triple]]
"""Returns the triples of a resource that are not in its record. Called in any thread."""


def _nothing(record: Record) -> Sequence[Triple]:
    return ()


class RecordGraphs:
    """`ChangeSource` of the graphs of all records, each equal to the representation of its resource.

    Another source provides the graphs of the containers `elsewhere`.
    """

    def __init__(
        self, records: Records, base: str, extra: ExtraTriples = _nothing, elsewhere: frozenset[str] = frozenset()
    ) -> None:
        self._records = records
        self._base = base
        self._extra = extra
        self._elsewhere = elsewhere
        self._times = _Times(base)

    @property
    def version(self) -> int:
        """The number of the last change."""
        return self._records.version

    def may_match(self, needs: Needs) -> bool:
        """Whether a query can match stored triples, which may be arbitrary."""
        return bool(needs.patterns) or needs.asks_graphs

    def last_change(self, graph: str) -> int:
        """Return the version of the last change of a graph, or an upper bound on it."""
        path = graph[len(self._base) :] if graph.startswith(self._base) else ""
        if not path or path.partition("/")[0] in _ROBOTS:
            return 0
        record = self._records.get(path)
        if record is None and path.endswith(META):
            record = self._records.get(path.removesuffix(META))
        return self._records.version if record is None else max(record.version, record.listed)

    def changes(self, after: int) -> Iterator[Changes]:
        """Yield the changes after a version, in parts."""
        return _Search(self._records, self._base, after, self._times, self._extra, self._elsewhere).parts()


class _Times:
    """Modification times in the graphs of containers, which change with their lists of members."""

    def __init__(self, base: str) -> None:
        self._base = base
        self._delivered: dict[str, dict[str, int]] = {}

    def tell(self, record: Record, after: int) -> tuple[str, str]:
        """Return a container's current triple and those it may replace, given that version `after` was delivered."""
        delivered = self._delivered.setdefault(record.path, {})
        certain = max((version for version in delivered.values() if version <= after), default=0)
        for line in [line for line, version in delivered.items() if version < certain]:
            del delivered[line]
        now = _modified_triples(record, self._base + record.path)
        delivered[now] = max(record.version, record.listed)
        return now, "".join(line for line in delivered if line != now)

    def drop(self, path: str) -> None:
        """Remove a container."""
        self._delivered.pop(path, None)


class _Search:
    """One search for changes after a version.

    Changed containers are sent whole, after everything else; members listed since then are added.
    """

    def __init__(
        self, records: Records, base: str, after: int, times: _Times, extra: ExtraTriples, elsewhere: frozenset[str]
    ) -> None:
        self._records = records
        self._extra = extra
        self._elsewhere = elsewhere
        self._base = base
        self._after = after
        self._times = times
        self._whole: dict[str, int] = {}  # versions of containers that were sent whole
        self._due: dict[str, None] = {}  # containers still to be sent whole
        self._graphs: dict[str, Callable[[], str] | None] = {}
        self._edits: list[Edit] = []
        self._size = 0

    def parts(self) -> Iterator[Changes]:
        """Yield changes until there are no more, so that no write is delivered in part.

        During continuous writes, stop `_MORE` pages after the initial changes. Records that change meanwhile are
        yielded again in this search or the next.
        """
        last, now, more = self._after, self._records.version, _MORE
        while True:
            page = self._records.changes_since(last, limit=_PAGE) if last < now or more else ()
            if page:
                more -= last >= now
                last = page[-1].version
                for changed in page:
                    self._look(changed)
                yield self._part(last)
            elif self._due:
                path = next(iter(self._due))
                del self._due[path]
                yield from self._container(path, last)
            else:
                return

    def _part(self, reached: int, unfinished: str | None = None) -> Changes:
        part = Changes(self._graphs, self._edits, self._size, reached, unfinished)
        self._graphs, self._edits, self._size = {}, [], 0
        return part

    def _look(self, changed: RecordChange) -> None:
        path = changed.path
        if path in self._elsewhere:
            return
        record = None if changed.is_removed else self._records.get(path)
        if record is None:
            self._drop(path)
        elif not record.model.is_container:
            steps = self._records.writes_since(record, self._after)
            if steps is None or self._extra(record):
                self._replace(record)
            else:
                self._step(path, steps)
        elif self._is_to_be_whole(record):
            self._due[path] = None
        else:
            added, removed = self._times.tell(record, self._after)
            self._edit(path, added, removed)
        above = container_of(path)
        container = None if above in self._elsewhere else self._records.get(above)
        if container is not None and container.listed > self._after and not self._is_to_be_whole(container):
            self._list(container, path, record)

    def _is_to_be_whole(self, container: Record) -> bool:
        """Whether a container changed since it was sent: all of it is sent later."""
        return container.version > self._whole.get(container.path, self._after)

    def _replace(self, record: Record) -> None:
        url = self._base + record.path
        self._graphs[url + META if record.model is Model.NON_RDF_SOURCE else url] = partial(
            _text, record, url, self._extra
        )
        self._size += unpacked_size(record.triples) + _OVERHEAD

    def _step(self, path: str, steps: Sequence[RecordWrite]) -> None:
        """Replay writes in order, which is safe for a graph that already contains some of them."""
        url = self._base + path
        for step in steps:
            before, after = (_managed_lines(record, url) for record in (step.before, step.after))
            difference = step.difference
            self._edit(
                path,
                difference.added.decode() + "".join(after - before),
                difference.removed.decode() + "".join(before - after),
            )

    def _drop(self, path: str) -> None:
        self._due.pop(path, None)
        self._times.drop(path)
        self._graphs[self._base + path] = None
        if self._records.get(path + META) is None:  # it may have been a file
            self._graphs[self._base + path + META] = None

    def _list(self, container: Record, path: str, record: Record | None) -> None:
        """Add a new member to a container's list, or remove a deleted one (None)."""
        if record is not None and record.created_ns == record.modified_ns:
            self._edit(container.path, self._lines(container, [(path, record.member)]))
        elif _is_indirect(container.membership):
            self._due[container.path] = None  # its former URI is unknown and may represent other members, too
        elif record is None:
            self._edit(container.path, removed=self._lines(container, [(path, None)]))
        else:
            self._edit(container.path, self._lines(container, [(path, record.member)]))

    def _container(self, path: str, reached: int) -> Iterator[Changes]:
        """Yield a container, then its members in pages. A container that changes meanwhile is yielded again."""
        container = self._records.get(path)
        if container is None:
            return
        self._whole[path] = container.version
        self._times.tell(container, self._after)
        self._replace(container)
        number = 0
        while True:
            found: Sequence[Member] = self._records.members(path, after=number, limit=_MEMBERS)
            if not found:
                break
            number = found[-1].number
            self._edit(path, self._lines(container, [(each.path, each.member) for each in found]))
            if len(found) == _MEMBERS:
                yield self._part(reached, self._base + path)
        yield self._part(reached)

    def _lines(self, container: Record, members: Sequence[tuple[str, str | None]]) -> str:
        """Return the lines about members: their paths, and their URIs in membership triples."""
        url = self._base + container.path
        lines = [f"<{url}> {ldp.contains} <{self._base + path}> .\n" for path, _ in members]
        membership = container.membership
        if membership is not None:
            named = member_derived_uris((self._base + path, member) for path, member in members)
            lines += (_membership(membership, member) for member in named)
        return "".join(lines)

    def _edit(self, path: str, added: str = "", removed: str = "") -> None:
        self._edits.append(Edit(self._base + path, added, removed))
        self._size += len(added) + len(removed)


def _is_indirect(membership: Membership | None) -> bool:
    """Whether members may be represented by other URIs in membership triples (LDP 5.5.1.2)."""
    return membership is not None and membership.content not in (None, ldp.MemberSubject.value)


def _membership(membership: Membership, member: str) -> str:
    """Return the membership triple of a member, as N-Triples."""
    constant, relation = membership.resource, membership.relation
    one, other = (member, constant) if membership.inverse else (constant, member)
    return f"<{one}> <{relation}> <{other}> .\n"


def _text(record: Record, url: str, extra: ExtraTriples) -> str:
    """Return the text of a record without members; client statements are copied unparsed."""
    membership = membership_declaration(record.membership, url) if record.membership is not None else ()
    managed = record_document(without_statements(record, url), url, (), (*membership, *extra(record)))
    return serialize(managed, Syntax.N_TRIPLES).decode() + client_ntriples(record, url).decode()


def _managed_lines(record: Record, url: str) -> frozenset[str]:
    """Return the server-managed lines of a record, and the times its client stated."""
    return frozenset(_text(without_statements(record, url), url, _nothing).splitlines(keepends=True))


def _modified_triples(record: Record, url: str) -> str:
    """Return the triples of the modification time."""
    extra = tuple(each for each in managed_triples(record, url) if each.predicate == dcterms.modified)
    return serialize(Document(url, extra), Syntax.N_TRIPLES).decode()
