"""Named graphs (SPARQL 1.1 Graph Store HTTP Protocol), as ratios to the Oxigraph server on the same graphs.

No two GETs are the same.

Run: python bench/gsp.py [seconds]. Needs `wrk` (Debian: apt-get install wrk) and `pip install oxigraph`.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import httpx
from sparql import oxigraph
from web import compare, compare_anew, heading, serving

TURTLE, TRIPLES = "text/turtle", "application/n-triples"
NUMBER = 9
"""Number of statements of a client: with those of the server they are about 1 kB of N-Triples."""
WRITE = """
wrk.method = "{method}"
wrk.headers["Content-Type"] = "text/turtle"
wrk.body = [[{body}]]
"""


class Row(NamedTuple):
    """One comparison: a label, the two URLs, and the arguments of `wrk`."""

    label: str
    ours: str
    theirs: str
    options: tuple[str, ...]


def body(url: str) -> str:
    """Return a small graph in Turtle."""
    return "".join(f'<{url}> <http://example.org/property{each}> "value {each} of it" .\n' for each in range(NUMBER))


def copied(rosld: str, other: str, graph: str) -> int:
    """Copy a graph to the other server; return its size in bytes of N-Triples."""
    with httpx.Client(timeout=30) as http:
        found = http.get(f"{rosld}graphs", params={"graph": graph}, headers={"Accept": TRIPLES}).raise_for_status()
        typed = {"Content-Type": TRIPLES}
        http.put(f"{other}store", params={"graph": graph}, content=found.content, headers=typed).raise_for_status()
    return len(found.content)


def rows(rosld: str, other: str, folder: Path) -> Iterator[Row]:
    """Yield all comparisons."""
    kept, live = f"{rosld}data/small", f"{rosld}topics/aircraft/engine/speed"
    typed = {"Content-Type": TURTLE}
    httpx.put(f"{rosld}graphs", params={"graph": kept}, content=body(kept), headers=typed).raise_for_status()
    for name, graph in (("kept", kept), ("live topic at 10 Hz", live)):
        size = copied(rosld, other, graph)
        for syntax, media_type in (("N-Triples", TRIPLES), ("Turtle", TURTLE)):
            named = quote(graph, safe="")
            yield Row(
                f"GET {name}, {size} bytes, {syntax}",
                f"{rosld}graphs?graph={named}",
                f"{other}store?graph={named}",
                ("-H", f"Accept: {media_type}"),
            )
    for method in ("PUT", "POST"):
        script = folder / f"{method}.lua"
        script.write_text(WRITE.format(method=method, body=body(kept)))
        named = quote(kept, safe="")
        yield Row(f"{method} kept", f"{rosld}graphs?graph={named}", f"{other}store?graph={named}", ("-s", str(script)))


def main() -> None:
    """Print the table."""
    if shutil.which("wrk") is None:
        raise SystemExit("bench/gsp.py needs wrk: apt-get install wrk")
    seconds = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    with (
        tempfile.TemporaryDirectory() as folder,
        serving("-m", "rosld", "serve", "aircraft", "--port", "0") as rosld,
        oxigraph() as other,
    ):
        heading(44, "oxigraph")
        for label, ours, theirs, options in rows(rosld, other, Path(folder)):
            told = compare_anew if label.startswith("GET") else compare
            told(44, label, ours, theirs, seconds, *options)


if __name__ == "__main__":
    main()
