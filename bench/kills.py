"""The query process killed a hundred times under load of GET, PUT, PATCH, streams and SPARQL: status of each request.

Run: python bench/kills.py [times]. Target: only SPARQL requests fail, and these with 503 and Retry-After.
"""

from __future__ import annotations

import statistics
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.server.conftest import start
from tests.server.sparql.killing import OF_SPARQL, OPTIONS, REQUESTS, STREAMS, Load, kill

TIMES = 100


def main() -> int:
    """Print the tables; return 1 if another request failed."""
    times = int(sys.argv[1]) if len(sys.argv) > 1 else TIMES
    served = start("aircraft", *OPTIONS)
    load = Load(served.url)
    try:
        pauses = [*kill(served, load, times)]
    finally:
        load.end()
    print(f"{'':22}{'answered':>10}{'503':>8}{'other':>8}{'slowest, s':>12}")
    for kind in (*REQUESTS, *STREAMS):
        counts = {status: number for (each, status), number in load.statuses.items() if each == kind}
        done = sum(number for status, number in counts.items() if 200 <= status < 300)
        refused = counts.get(503, 0)
        other = sum(counts.values()) - done - refused
        slowest = f"{load.slowest[kind]:12.2f}" if kind in REQUESTS else f"{load.events[kind]:>12,} events"
        print(f"{kind:22}{done:10,}{refused:8,}{other:8,}{slowest}")
        if other or (refused and kind not in OF_SPARQL):
            load.wrong.append(f"{kind}: {counts}")
    load.wrong += [f"{kind}: {number} without Retry-After" for kind, number in load.without_retry.items()]
    print(f"{times} kills; answered again after {statistics.median(pauses):.2f} s, {max(pauses):.2f} s at most")
    for words in load.wrong:
        print(words)
    return int(served.stop() != 0 or bool(load.wrong))


if __name__ == "__main__":
    sys.exit(main())
