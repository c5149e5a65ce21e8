"""Durations of requests, queries and commands, as histograms that are read when they are scraped.

Counting is the only work on the way of a request: two look-ups and two additions.
"""

from __future__ import annotations

import time
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager

from rosld.server.runtime.tracing import span

BOUNDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
"""Upper bounds of the buckets in seconds; the last bucket has none."""


class Histogram:
    """Number of durations in each bucket, and their sum in seconds."""

    __slots__ = ("counts", "sum")

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS) + 1)
        self.sum = 0.0

    def add(self, seconds: float) -> None:
        """Count a duration."""
        self.counts[bisect_left(BOUNDS, seconds)] += 1
        self.sum += seconds

    def include(self, other: Histogram) -> None:
        """Add the durations of another histogram."""
        self.counts = [own + more for own, more in zip(self.counts, other.counts, strict=True)]
        self.sum += other.sum


class Timings:
    """Durations of one kind of operation, by operation and outcome. `outcome_of` names the outcome of an exception."""

    def __init__(self, outcome_of: Callable[[BaseException], str]) -> None:
        self.histograms: defaultdict[tuple[str, str], Histogram] = defaultdict(Histogram)
        self._outcome_of = outcome_of

    @contextmanager
    def measure(self, operation: str, attributes: Mapping[str, str] = {}) -> Iterator[None]:
        """Count an operation with its outcome, as a span with these attributes if requests are traced."""
        started, outcome = time.perf_counter(), "ok"
        with span(operation, attributes):
            try:
                yield
            except BaseException as error:
                outcome = self._outcome_of(error)
                raise
            finally:
                self.histograms[operation, outcome].add(time.perf_counter() - started)


_METHODS = frozenset({"DELETE", "GET", "HEAD", "OPTIONS", "PATCH", "POST", "PUT"})
UNKNOWN = "{unknown}"
"""Route of all paths that lead to no resource."""


class RequestTimings:
    """Durations of requests by method, route and status. `routes` are the first segments of all paths below `base`."""

    def __init__(self, base: str, routes: Collection[str]) -> None:
        self.current = 0
        """Number of requests in progress, including streams."""
        self.histograms: dict[tuple[bytes, bool, str, int], Histogram] = {}
        self._start = len(base)
        self._routes = frozenset(routes)

    def add(self, path: bytes, method: str, status: int, seconds: float) -> None:
        """Count a request."""
        route, is_whole = self._split(path)
        found = self.histograms.get((route, is_whole, method, status))
        (self._new(route, is_whole, method, status) if found is None else found).add(seconds)

    def route(self, path: bytes) -> str:
        """Return the route of a path: `/topics/{name}`, `/topics/`, `/status`."""
        route, is_whole = self._split(path)
        return self.template(route, is_whole) if self._is_known(route) else UNKNOWN

    @staticmethod
    def template(route: bytes, is_whole: bool) -> str:
        """Return the name of a route from its parts in the keys of `histograms`."""
        text = route.decode("latin-1")
        return text if text == UNKNOWN else f"/{text}" if is_whole else f"/{text}{{name}}"

    def _split(self, path: bytes) -> tuple[bytes, bool]:
        """Return the first segment with its slash, and whether nothing follows."""
        start = self._start
        end = path.find(b"/", start) + 1
        return (path[start:end], end == len(path)) if end else (path[start:], True)

    def _is_known(self, route: bytes) -> bool:
        return route.decode("latin-1").removesuffix("/") in self._routes

    def _new(self, route: bytes, is_whole: bool, method: str, status: int) -> Histogram:
        """Return the histogram of a combination that is not counted yet; unknown paths and methods share theirs."""
        if not self._is_known(route):
            route, is_whole = UNKNOWN.encode("ascii"), True
        if method not in _METHODS:
            method = "other"
        return self.histograms.setdefault((route, is_whole, method, status), Histogram())
