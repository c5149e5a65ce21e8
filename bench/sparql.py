"""SPARQL over live values, as ratios: to the Oxigraph server on the same data, and to the same query without any sync.

Run: python bench/sparql.py [seconds]. Needs `wrk` (Debian: apt-get install wrk) and `pip install oxigraph`.
`python bench/sparql.py cpu [seconds]` prints only the CPU of one query or write, without wrk; where the Oxigraph server
is not installed, that of rosld alone.
"""

from __future__ import annotations

import gc
import os
import shutil
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, asynccontextmanager, contextmanager, suppress
from functools import partial
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import quote, urlsplit

import httpx
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from web import compare_anew, heading, serving

from rosld.adapters.model import Encoding, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.schema import MessageSchema
from rosld.ontology.document import Envelope
from rosld.ontology.lift import TYPES, lifter
from rosld.ontology.urls import Space
from rosld.ontology.vocab import PREFIXES, rdf, ros
from rosld.server.auth.permissions import Permissions
from rosld.server.rest.resource import Resource
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.materializer import GraphEntry, LiveDocument, LiveGraphs, Materializer
from rosld.server.sparql.needs import Needs, StatedTerms
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.protocol import query_request
from rosld.server.sparql.query_service import QueryService

BASE = "http://127.0.0.1:8080/"
TOPICS = 1000
ROWS = 20_000
TURNS = 15
SERVE = "serve"
CPU = "cpu"
PAUSE = 0.25
"""Seconds between two queries: longer than the validity of a synchronization with the robot."""
NEW_TEXT = """
local number = 0
request = function()
  number = number + 1
  return wrk.format(nil, wrk.path .. "%20%23" .. number)
end
"""
"""No two queries have the same text: each has a comment of its own and is parsed anew."""
DATA = f"{TYPES}std_msgs/msg/Float64#data"


OXIGRAPH = shutil.which("oxigraph") or str(Path(sys.executable).with_name("oxigraph"))
BATTERY = f"<topics/battery_state> ros:latest ?m . ?m <{TYPES}sensor_msgs/msg/BatteryState#percentage> ?v"
QUERIES = {
    "two patterns": "SELECT ?n ?t { ?n ros:publishes ?t . ?t a ros:Topic }",
    "one pattern": "SELECT ?n ?t { ?n ros:publishes ?t }",
    "path to a live value": f"SELECT ?v {{ {BATTERY} }}",
    "path with OPTIONAL": f"SELECT ?v {{ {BATTERY.replace('. ?m', 'OPTIONAL { ?m')} }} }}",
    "UNION": "SELECT ?t { { ?t a ros:Topic } UNION { ?t a ros:Service } }",
    "VALUES": "SELECT ?t { VALUES ?c { ros:Topic ros:Service } ?t a ?c }",
    "FILTER NOT EXISTS": "SELECT ?t { ?t a ros:Topic FILTER NOT EXISTS { ?n ros:publishes ?t } }",
    "ASK {}": "ASK {}",
    "SELECT (1 AS ?x) {}": "SELECT (1 AS ?x) {}",
    "?s ?p ?o LIMIT 10": "SELECT * { ?s ?p ?o } LIMIT 10",
    "all of a live value": "SELECT ?p ?v { <topics/battery_state> ros:latest ?m . ?m ?p ?v }",
    "COUNT of everything": "SELECT (COUNT(*) AS ?n) { ?s ?p ?o }",
}
"""Queries by subject."""
TWIST = f"{TYPES}geometry_msgs/msg/Twist"
VECTOR = f"{TYPES}geometry_msgs/msg/Vector3"
VELOCITY = (
    f"<#message> a <{TWIST}> ; <{TWIST}#linear> [ a <{VECTOR}> ; <{VECTOR}#x> NUMBERe-9 ; <{VECTOR}#y> 0e0 ; "
    f"<{VECTOR}#z> 0e0 ] ; "
    f"<{TWIST}#angular> [ a <{VECTOR}> ; <{VECTOR}#x> 0e0 ; <{VECTOR}#y> 0e0 ; <{VECTOR}#z> 0e0 ] ."
)
DRIVE = (
    f"DELETE {{ GRAPH <topics/cmd_vel> {{ ?v <{VECTOR}#x> ?old }} }} "
    f"INSERT {{ GRAPH <topics/cmd_vel> {{ ?v <{VECTOR}#x> NUMBERe-9 }} }} "
    f"WHERE {{ GRAPH <topics/cmd_vel> {{ ?m <{TWIST}#linear> ?v . ?v <{VECTOR}#x> ?old }} }}"
)
WRITES = {
    "PUT of a new document": ("PUT", "/data/put/NUMBER", "<> rdf:value NUMBER , 'a' ."),
    "INSERT DATA, a new document": (
        "POST",
        "/sparql",
        "INSERT DATA { GRAPH <data/new/NUMBER> { <data/new/NUMBER> rdf:value NUMBER , 'a' } }",
    ),
    "PUT of a document": ("PUT", "/data/one", "<> rdf:value NUMBER , 'a' ."),
    "INSERT DATA into a document": (
        "POST",
        "/sparql",
        "INSERT DATA { GRAPH <data/few/DIGIT> { <data/few/DIGIT> rdf:value NUMBER } }",
    ),
    "PUT that publishes": ("PUT", "/topics/cmd_vel", VELOCITY),
    "update that publishes": ("POST", "/sparql", DRIVE),
}
"""Writes by effect; NUMBER differs in each request, DIGIT is one of a hundred."""


# The CPU of one request


def children_of(pid: int) -> set[int]:
    """Return the child processes of a process."""
    return {int(child) for file in Path(f"/proc/{pid}/task").glob("*/children") for child in file.read_text().split()}


def cpu_milliseconds(pid: int) -> float:
    """Return the CPU time of a process and all its children, including finished ones."""
    used = 0.0
    with suppress(FileNotFoundError, ProcessLookupError):
        for file in Path(f"/proc/{pid}/task").glob("*/schedstat"):
            used += int(file.read_text().split()[0]) / 1e6
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        used += (int(fields[13]) + int(fields[14])) * 1e3 / os.sysconf("SC_CLK_TCK")
        used += sum(map(cpu_milliseconds, children_of(pid)))
    return used


def cpu_of_queries(seconds: float) -> None:
    """Print the CPU time of all processes for one request on one connection, each with its own text, on the rover."""
    with ExitStack() as servers:
        rosld = servers.enter_context(
            serving("-m", "rosld", "serve", "rover", "--port", "0", "--max-publish-rate", "1000000")
        )
        [ours] = children_of(os.getpid())
        clients = [(Client(rosld), "/sparql", ours)]
        for query in QUERIES.values():
            httpx.get(f"{rosld}sparql", params={"query": query}).raise_for_status()
        if Path(OXIGRAPH).exists():
            other = servers.enter_context(oxigraph())
            [theirs] = children_of(os.getpid()) - {ours}
            copy(rosld, other)
            clients.append((Client(other), "/query", theirs))
        print(f"{'CPU of one request, in ms':36}{'rosld':>10}{'p50':>10}{'oxigraph':>12}{'p50':>10}")
        for label, query in QUERIES.items():
            text = f"BASE <{rosld}> {declarations(query)}{query}"
            found = [cpu_of(pid, seconds, partial(client.seconds, path, text)) for client, path, pid in clients]
            print(f"{label:36}" + "  ".join(f"{cpu:10.2f}{median:10.2f}" for cpu, median in found))
        client = Client(rosld)
        for label, (method, path, body) in WRITES.items():
            base = "" if method == "PUT" else f"BASE <{rosld}> "
            cpu, median = cpu_of(
                ours, seconds, partial(client.write, method, path, f"{base}{declarations(body)}{body}")
            )
            print(f"{label:36}{cpu:10.2f}{median:10.2f}")


def declarations(text: str) -> str:
    """Return the declarations of the prefixes in a text."""
    return "".join(f"PREFIX {name}: <{iri}> " for name, iri in PREFIXES.items() if f"{name}:" in text)


def cpu_of(pid: int, seconds: float, send: Callable[[int], float]) -> tuple[float, float]:
    """Return the CPU milliseconds of a request, without those of an idle server, and the median duration."""
    send(0)
    begun, before = time.perf_counter(), cpu_milliseconds(pid)
    time.sleep(seconds)
    idle = (cpu_milliseconds(pid) - before) / (time.perf_counter() - begun)
    times: list[float] = []
    begun, before = time.perf_counter(), cpu_milliseconds(pid)
    while time.perf_counter() - begun < seconds:
        times.append(send(len(times) + 1) * 1e3)
    used = cpu_milliseconds(pid) - before - idle * (time.perf_counter() - begun)
    return used / len(times), statistics.median(times)


# Against the Oxigraph server


@contextmanager
def oxigraph() -> Iterator[str]:
    """Run the Oxigraph server on a free port until it is ready."""
    command = OXIGRAPH
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = ("serve", "--bind", f"127.0.0.1:{port}", "--union-default-graph")
    process = subprocess.Popen([str(command), *options], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        process.stderr.readline()  # it listens
        yield f"http://127.0.0.1:{port}/"
    finally:
        process.terminate()
        process.wait(10)


def copy(rosld: str, other: str) -> int:
    """Copy all graphs of one server to the other; return their number."""
    with httpx.Client(timeout=30) as http:
        listed = http.get(f"{rosld}sparql", params={"query": "SELECT DISTINCT ?g { GRAPH ?g { ?s ?p ?o } }"})
        graphs = [row["g"]["value"] for row in listed.json()["results"]["bindings"]]
        for graph in graphs:
            query = f"CONSTRUCT {{ ?s ?p ?o }} WHERE {{ GRAPH <{graph}> {{ ?s ?p ?o }} }}"
            headers = {"Accept": "application/n-triples"}
            found = http.get(f"{rosld}sparql", params={"query": query}, headers=headers)
            put = http.put(
                f"{other}store",
                params={"graph": graph},
                content=found.content,
                headers={"Content-Type": "application/n-triples"},
            )
            put.raise_for_status()
    return len(graphs)


def against_oxigraph(seconds: int) -> None:
    """Compare small SELECTs over one live resource on both servers."""
    with serving("-m", "rosld", "serve", "aircraft", "--port", "0") as rosld, oxigraph() as other:
        topic = f"{rosld}topics/aircraft/engine/speed"
        small = f"SELECT ?x {{ <{topic}> <{ros.latest.value}> ?m . ?m <{DATA}> ?x }}"
        graph = f"SELECT ?p ?o {{ GRAPH <{topic}> {{ <{topic}#message> ?p ?o }} }}"
        httpx.get(f"{rosld}sparql", params={"query": graph}).raise_for_status()
        print(f"{copy(rosld, other)} graphs on both")
        heading(36, "oxigraph")
        for label, query in (
            ("SELECT, one value at 10 Hz", small),
            ("SELECT, a message's graph at 10 Hz", graph),
        ):
            ours, theirs = f"{rosld}sparql?query={quote(query)}", f"{other}query?query={quote(query)}"
            compare_anew(36, label, ours, theirs, seconds, anew=NEW_TEXT)


def many_rows() -> None:
    """Compare answers of 20,000 rows in JSON from both servers: the minimum of several distinct queries."""
    triples = "".join(
        f'<{BASE}x/{n}> <{BASE}name> "number {n}" .\n<{BASE}x/{n}> a <{BASE}Thing> .\n' for n in range(ROWS)
    )
    with serving("-m", "rosld", "serve", "aircraft", "--port", "0") as rosld, oxigraph() as other:
        kept = httpx.put(f"{rosld}data/many", content=triples, headers={"Content-Type": "text/turtle"}, timeout=60)
        kept.raise_for_status()
        copy(rosld, other)
        print(f"{'':36}{'rosld':>10}{'oxigraph':>15}{'ratio':>8}")
        for label, query in (
            ("20,000 rows, one pattern", f"SELECT ?s ?n {{ ?s <{BASE}name> ?n }}"),
            ("20,000 rows, a join", f"SELECT ?s ?n {{ ?s a <{BASE}Thing> ; <{BASE}name> ?n }}"),
            ("20,000 rows, in order", f"SELECT ?s ?n {{ ?s <{BASE}name> ?n }} ORDER BY ?n"),
        ):
            clients = ((Client(rosld), "/sparql"), (Client(other), "/query"))
            times = [
                [client.seconds(f"{path}?query={quote(query + ' ' * turn)}") * 1e3 for client, path in clients]
                for turn in range(TURNS)
            ]
            ours, theirs = (min(pair[at] for pair in times) for at in (0, 1))
            print(f"{label:36}{ours:7.1f} ms{theirs:12.1f} ms{ours / theirs:8.2f}")


# A thousand topics, all changed since the last query


class Robot:
    """A thousand topics of Twists, lifted as in the server."""

    revision = 0

    def __init__(self) -> None:
        library = TypeLibrary(ros_version=1)
        schema = library.find(TypeRef("geometry_msgs/msg/Twist"))
        assert isinstance(schema, MessageSchema)
        self._lifter = lifter(schema)
        fields = (f"{TYPES}{kind.name}#{field.name}" for kind in schema.types.values() for field in kind.fields)
        self._told = StatedTerms(frozenset({*fields, ros.latest.value, rdf.type.value}), frozenset())
        self._resource = Resource(Space(BASE), BASE)
        vector = schema.codec.build("geometry_msgs/msg/Vector3", {"x": 1.5, "y": -0.25, "z": 3.0})
        message = schema.codec.build(schema.ref.name, {"linear": vector, "angular": vector})
        self._message = schema.codec.decode(schema.codec.encode(message, Encoding.ROS1), Encoding.ROS1)
        self._turn = 0
        self._urls = [f"{BASE}topics/t{number}" for number in range(TOPICS)]
        self._descriptions = {url: GraphEntry(url, 0, lambda url=url: self._described(url)) for url in self._urls}  # type: ignore[misc]

    def tick(self) -> None:
        """Publish a new message on every topic."""
        self._turn += 1

    writes = 0

    def descriptions(self) -> Mapping[str, GraphEntry]:
        return self._descriptions

    async def prepare(self, needs: Needs) -> None:
        """Lift all messages."""

    def wanted(self, needs: Needs, permissions: Permissions) -> Sequence[LiveDocument]:
        named = {pattern.graph or pattern.document for pattern in needs.patterns}
        urls = self._urls if None in named else [url for url in self._urls if url in named]
        return [LiveDocument(url, self._resource, url in named) for url in urls if needs.may_match(url, self._told)]

    async def read(self, documents: Sequence[LiveDocument], *, deadline: float) -> LiveGraphs:
        return LiveGraphs({one.url: self._entry(one.url) for one in documents}, {})

    def _entry(self, url: str) -> GraphEntry:
        turn = self._turn
        return GraphEntry(url, turn, lambda: self._described(url) + self._lifted(url, turn))

    def _described(self, url: str) -> str:
        return (
            f"<{url}> {rdf.type} {ros.Topic} .\n"
            f'<{url}> {ros.name} "{url.removeprefix(BASE)}" .\n'
            f"<{url}> {ros.publishedBy} <{BASE}nodes/driver> .\n"
        )

    def _lifted(self, url: str, turn: int) -> str:
        envelope = Envelope(1_700_000_000_000_000_000 + turn, turn, f"{BASE}nodes/driver")
        text = self._lifter.ntriples(self._message, url, "#message", envelope=envelope)
        return f"<{url}> {ros.latest} <{url}#message> .\n{text}"


def serve() -> None:
    """Serve the thousand topics over HTTP: /sparql; /tick for a new message on each; /idle for an empty response."""
    robot, process = Robot(), QueryProcess(4, 256)
    service = QueryService(process, Materializer(process, robot), Analyser(BASE, TYPES))

    async def sparql(request: Request) -> Response:
        answer = await service.answer(query_request("GET", request.scope["query_string"]), "text/csv")
        assert isinstance(answer.body, bytes)
        return Response(answer.body)

    async def tick(request: Request) -> Response:
        robot.tick()
        return Response()

    async def idle(request: Request) -> Response:
        return Response()

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        await process.start()
        yield
        await process.close()

    routes = [Route("/sparql", sparql), Route("/tick", tick), Route("/idle", idle)]
    app = Starlette(routes=routes, lifespan=lifespan)
    listening = socket.socket()
    listening.bind(("127.0.0.1", 0))
    listening.listen()
    print(f"http://127.0.0.1:{listening.getsockname()[1]}/", flush=True)
    gc.collect()
    gc.freeze()  # loaded objects remain: the collector need not scan them again and again
    config = uvicorn.Config(app, loop="uvloop", http="httptools", access_log=False, log_level="error")
    uvicorn.Server(config).run(sockets=[listening])


class Client:
    """One connection."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._connection = HTTPConnection(parts.hostname or "", parts.port)

    def seconds(self, path: str, query: str = "", number: int = 0) -> float:
        """Return the duration of a GET, or of a query, whose text a number makes unique."""
        url = f"{path}?query={quote(f'{query} #{number}')}" if query else path
        return self._request("GET", url, None, {"Accept": "application/sparql-results+json, text/csv"})

    def write(self, method: str, path: str, body: str, number: int) -> float:
        """Return the duration of a write."""
        path, body = (each.replace("NUMBER", str(number)).replace("DIGIT", str(number % 100)) for each in (path, body))
        media_type = "application/sparql-update" if path == "/sparql" else "text/turtle"
        return self._request(method, path, body, {"Content-Type": media_type})

    def _request(self, method: str, path: str, body: str | None, headers: dict[str, str]) -> float:
        begun = time.perf_counter()
        self._connection.request(method, path, body, headers)
        response = self._connection.getresponse()
        answer = response.read()
        assert response.status < 300, (path, answer)
        return time.perf_counter() - begun


def milliseconds(client: Client, query: str, pause: float, *, changed: bool) -> float:
    """Return the median latency, `pause` seconds after all topics changed, or with nothing changed."""
    times = []
    for _ in range(TURNS):
        client.seconds("/tick" if changed else "/idle")
        time.sleep(pause)
        times.append(client.seconds(f"/sparql?query={quote(query)}"))
    return statistics.median(times) * 1e3


def longest_hold(url: str, query: str) -> tuple[float, float]:
    """Return median and maximum latency in milliseconds of empty responses while wildcard queries run."""
    held: list[float] = []
    ended = threading.Event()

    def watch() -> None:
        client = Client(url)
        while not ended.is_set():
            held.append(client.seconds("/idle") * 1e3)

    watcher = threading.Thread(target=watch)
    watcher.start()
    milliseconds(Client(url), query, PAUSE, changed=True)
    ended.set()
    watcher.join()
    return statistics.median(held), max(held)


def a_thousand_topics() -> None:
    """Measure the cost of synchronization for the query that needs it, and for other requests."""
    ten = " ".join(f"<{BASE}topics/t{number}>" for number in range(10))
    over_ten = f"SELECT ?p ?o {{ VALUES ?t {{ {ten} }} ?t ros:latest ?m . ?m ?p ?o }}"
    wildcard = "SELECT (COUNT(*) AS ?n) { ?s ?p ?o }"
    with serving(__file__, SERVE) as url:
        client = Client(url)
        milliseconds(client, wildcard, PAUSE, changed=True)
        print(f"{'':36}{'changed':>10}{'unchanged':>12}{'ratio':>8}")
        for label, query, pause in ((f"10 of {TOPICS} topics", over_ten, 0.0), ("wildcard", wildcard, PAUSE)):
            changed, unchanged = (milliseconds(client, query, pause, changed=each) for each in (True, False))
            print(f"{label:36}{changed:7.2f} ms{unchanged:9.2f} ms{changed / unchanged:8.2f}")
        usual, longest = longest_hold(url, wildcard)
        print(f"another request meanwhile: {usual:.2f} ms as a rule, {longest:.1f} ms at most")


def main() -> None:
    """Print the tables."""
    if sys.argv[1:2] == [CPU]:
        cpu_of_queries(float(sys.argv[2]) if len(sys.argv) > 2 else 2.0)
        return
    if shutil.which("wrk") is None:
        raise SystemExit("bench/sparql.py needs wrk: apt-get install wrk")
    cpu_of_queries(2.0)
    against_oxigraph(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
    many_rows()
    a_thousand_topics()


if __name__ == "__main__":
    if sys.argv[1:] == [SERVE]:
        serve()
    else:
        main()
