"""Robots, and parts of robots, denied to an agent are mentioned nowhere on a server of several robots.

The robot `zq7x9bot` is denied as a whole, and of `part` everything whose name contains `zq7x9`; both have topics of the
same names as `open`, which everybody may read. What is denied is named as in `test_denied_everywhere.py`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import pytest

from rosld.adapters.base import AdapterOptions
from rosld.server.app import Application
from rosld.server.robots.robots import Robots
from rosld.server.serving.lifespan import lifespan
from rosld.server.settings import Settings
from tests.server.auth.conftest import rule, token, tokens
from tests.server.auth.test_denied_everywhere import (
    BASE,
    JSON,
    QUERIES,
    SYNTAXES,
    TURTLE,
    UPDATE,
    VARIANTS,
    Answer,
    Client,
    Crawl,
    Secretive,
)
from tests.server.events.conftest import HOST, Reader
from tests.server.robots.made_up import MadeUp

pytestmark = pytest.mark.slow

PATHS = (
    "/.well-known/**", "/activity/**", "/data/**", "/docs/**", "/faults/**", "/find", "/llms.txt", "/metrics", "/mcp",
    "/openapi.json", "/asyncapi.json", "/queries/**", "/robots", "/sparql", "/status", "/stop", "/types/**",
)  # fmt: skip
RULES = (
    rule("admin", "read write control administer", "/**")
    + rule("everywhere", "read write control", "/**")
    + rule("everywhere", "read write control", "/robots/zq7x9*", "/robots/zq7x9*/**", deny=True)
    + rule("everywhere", "read write control", "/robots/part/**/*zq7x9*", "/robots/part/**/*zq7x9*/**", deny=True)
    + rule("everywhere", "read write control", "/robots/part/services/*et_grip", deny=True)
    + rule("listed", "read write control", *PATHS, "/robots/open", "/robots/open/**", "/robots/part/topics/open")
    + rule("typed", "read write control", "/**")
    + rule("typed", "control", "/**", types="geometry_msgs/*", deny=True)
)
BELOW = (
    "", "topics/", "topics/open", "stop", "readyz", "healthz", "sparql", "openapi.json", "llms.txt", "metrics", "mcp",
    "find?q=open", "foxglove", "channels/", "bags/history/", "data/zq7x9", "%7A", "acl",
)  # fmt: skip
METHODS = ("HEAD", "OPTIONS", "PUT", "POST", "DELETE")
LOOKED_AT = (
    "/", "/robots", "/robots/", "/sparql", "/find", "/find?q=open", "/find?q=zq", "/find?q=speed&values=true",
    "/faults/", "/stop", "/status", "/activity/", "/metrics", "/docs/", "/llms.txt", "/openapi.json", "/asyncapi.json",
    "/queries/", "/data/", "/data/plan", "/.well-known/", "/.well-known/solid", "/cockpit/", "/types/", "/readyz",
    "/robots/part/", "/robots/part/topics/", "/robots/part/topics/open", "/robots/part/faults/", "/robots/open/",
    "/robots/open/find?q=zq",
)  # fmt: skip
FAULT = {"status": [{"name": "zq7x9 motor", "level": 2, "message": "zq7x9hot"}]}


def plain() -> MadeUp:
    """Return a robot without secrets, whose topics the others have, too."""
    robot = MadeUp()
    robot.topic("/open", "std_msgs/msg/Float64", {"data": 1.5})
    robot.topic("/cmd_vel", "geometry_msgs/msg/Twist", heard=True, published=False)
    return robot


@contextlib.asynccontextmanager
async def site(folder: Path) -> AsyncIterator[tuple[Application, Mapping[str, MadeUp]]]:
    """The server of the three robots, after writes of an administrator to all of them."""
    made = {"open": plain(), "part": Secretive(), "zq7x9bot": Secretive()}
    file = folder / "auth.toml"
    file.write_text(tokens("admin", "everywhere", "listed", "typed") + RULES)

    def open_adapter(source: str, options: AdapterOptions) -> Any:
        return made[source]

    settings = Settings(base_url=BASE, auth=file, data=folder / "data", history=("*",), client_rate=1e9,
                        client_streams=1000, receipt_excerpt=200, first_value_wait=0.1)  # fmt: skip
    robots = Robots({name: name for name in made}, settings, open_adapter)
    async with lifespan(robots):
        app = cast(Application, robots)
        admin = Client(app, "admin")
        for name in ("part", "zq7x9bot"):
            for path, body in ((f"topics/{name}", b'{"data": 1}'), ("topics/zq7x9_words", b'{"data": "zq7x9said"}')):
                await admin("PUT", f"/robots/{name}/{path}", body, Content_Type=JSON)
            text = f"INSERT DATA {{ GRAPH <robots/{name}/data/zq7x9> {{ <#x> rdfs:comment 'zq7x9new' }} }}"
            assert (await admin("POST", "/sparql", text.encode(), Content_Type=UPDATE)).status == 204
        made["part"].publishes("/zq7x9_diagnostics", FAULT)
        made["zq7x9bot"].publishes("/diagnostics", FAULT)
        plan = b"# %s\n<> <http://e.x/about> </robots/zq7x9bot/>, </robots/part/topics/zq7x9_speed> ." % (
            b"x" * 300
        )  # longer than an excerpt
        assert (await admin("PUT", "/data/plan", plan, Content_Type=TURTLE)).status == 201
        reason = b'{"reason": "zq7x9 on fire"}'
        assert (await admin("POST", "/robots/zq7x9bot/stop", reason, Content_Type=JSON)).status == 200
        yield app, made


async def test_no_answer_at_the_base_tells_of_a_denied_robot(tmp_path: Path) -> None:
    async with site(tmp_path) as (app, _):
        for agent in ("everywhere", "listed"):
            await look_everywhere(Crawl(app, agent))
        assert (await Client(app, "admin")("GET", "/robots/", Accept=JSON)).leaks


async def look_everywhere(crawl: Crawl) -> None:
    """Read everything at the base, and stop all robots, while streams are open."""
    streams = [
        crawl.ask.begin("GET", f"{path}?format={format}", Accept="text/event-stream")
        for path in ("/robots/", "/faults/", "/stop", "/activity/")
        for format in ("json", "ttl", "html")
    ]
    for path in LOOKED_AT:
        is_about_all = path in ("/robots/", "/faults/")
        for syntax in SYNTAXES if is_about_all else (JSON, TURTLE, "text/html"):
            await crawl.request("GET", path, Accept=syntax)
        for each in ("offer", *VARIANTS) if is_about_all else ():
            await crawl.request("GET", f"{path}{'&' if '?' in path else '?'}{each}")
        await crawl.request("OPTIONS", path)
    for text in QUERIES:
        await crawl.request(
            "POST", "/sparql", text.encode(), Content_Type="application/sparql-query", Accept="text/csv"
        )
    for query in ("?dry-run=true", ""):
        for accept in (JSON, TURTLE, "text/html"):
            answer = await crawl.request("POST", f"/stop{query}", b"{}", Content_Type=JSON, Accept=accept)
            assert answer.status == 200
    for path in ("/robots/", "/stop", "/activity/", "/metrics"):
        for syntax in (JSON, TURTLE, "text/html"):
            await crawl.request("GET", path, Accept=syntax)
    for stream in streams:
        answer = await stream.hang_up()
        assert answer.status == 200
        if answer.leaks:
            crawl.leaks[answer.request] = answer.leaks
    assert {200, 307} <= crawl.ask.statuses.keys()
    assert not crawl.leaks
    assert not crawl.failures


async def ask(app: Application, agent: str | None, method: str, path: str, body: bytes = b"", **headers: str) -> Answer:
    """Return the response to a request of an agent, None for anybody."""
    own = {} if agent is None else {"authorization": f"Bearer {token(agent)}"}
    sent = {name.replace("_", "-").lower(): value for name, value in headers.items()}
    request = Reader(app, path, own | sent, method, body)
    await asyncio.wait_for(request.task, 20)
    return Answer("", request.status, request.headers, b"".join(request.chunks))


async def handshake(app: Application, agent: str | None, path: str) -> str:
    """Return the refusal of a WebSocket."""
    sent: list[Any] = []

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.connect"}

    async def send(message: Any) -> None:
        sent.append(message)

    own = [] if agent is None else [(b"authorization", f"Bearer {token(agent)}".encode())]
    scope = {
        "type": "websocket", "path": path, "raw_path": path.encode(), "query_string": b"", "scheme": "ws",
        "headers": [(b"host", HOST), *own], "subprotocols": ["foxglove.sdk.v1"], "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 8080), "root_path": "", "extensions": {"websocket.http.response": {}},
    }  # fmt: skip
    await asyncio.wait_for(app(scope, receive, send), 20)
    return repr(sent)


async def test_a_denied_robot_is_as_one_that_does_not_exist(tmp_path: Path) -> None:
    there, never = "zq7x9bot", "zq7x9non"
    insert = "INSERT DATA {{ GRAPH <robots/{}/data/x> {{ <#x> rdfs:label 'x' }} }}"
    texts = (
        (UPDATE, insert),
        (UPDATE, insert + "; " + insert.replace("{}", "open")),
        (UPDATE, "DROP GRAPH <robots/{}/data/zq7x9>"),
        ("application/sparql-query", "SELECT * {{ GRAPH <robots/{}/> {{ ?s ?p ?o }} }}"),
        ("application/sparql-query", "SELECT * {{ ?t ros:past ?m . ?m ros:recordedIn <robots/{}/bags/history/> }}"),
        ("application/sparql-query", "SELECT * FROM <robots/{}/bags/history/> {{ ?t ros:past ?m }}"),
    )
    requests: list[tuple[str, str, bytes, str]] = [
        *(("POST", "/sparql", text.encode(), kind) for kind, text in texts),
        *(("GET", f"/robots/{{}}/{path}", b"", JSON) for path in BELOW),
        *((method, f"/robots/{{}}/{path}", b"{{}}", JSON) for path in ("", "topics/open", "mcp") for method in METHODS),
        *((method, "/robots/{}", b"{{}}", JSON) for method in ("GET", "PUT", "DELETE")),
    ]

    async def answer(app: Application, agent: str | None, name: str, *request: Any) -> Sequence[object]:
        method, path, body, kind = request
        text = body.decode().format(name).encode()
        found = await ask(app, agent, method, path.format(name), text, Content_Type=kind, Accept=f"{JSON}, text/html")
        left = {key: value for key, value in found.headers.items() if key not in ("date", "x-request-id")}
        return json.loads(json.dumps([found.status, left, found.body.decode()]).replace(name, "NAME"))

    async with site(tmp_path) as (app, _):
        for agent in (None, "listed"):
            for request in requests:
                first, second = [await answer(app, agent, name, *request) for name in (there, never)]
                assert first == second, (agent, request)
            for path in ("foxglove", "channels/WebSocketChannel2023/token/messages", "channels/", "x"):
                found = [await handshake(app, agent, f"/robots/{name}/{path}") for name in (there, never)]
                assert found[0].replace(there, never) == found[1]


async def test_no_spelling_of_a_robot_escapes_a_rule_about_types(tmp_path: Path) -> None:
    async with site(tmp_path) as (app, made):
        for name in ("open", "%6Fpen"):
            answer = await ask(app, "typed", "PUT", f"/robots/{name}/topics/cmd_vel", b"{}", Content_Type=JSON)
            assert answer.status in (403, 404)
        assert "/cmd_vel" not in made["open"].sent
