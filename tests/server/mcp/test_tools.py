"""Tools for language models, over the protocol: a model flies, drives, waits, looks, is refused, and stops."""

from __future__ import annotations

import asyncio
import base64
import io
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from mcp import types
from mcp.client.stdio import StdioServerParameters
from mcp.client.streamable_http import streamable_http_client
from mcp.shared._httpx_utils import create_mcp_http_client
from mcp.shared.exceptions import MCPError
from PIL import Image

from rosld.ontology.urls import Space
from rosld.server.auth.tokens import token_digest
from rosld.server.mcp.protocol import create_server
from rosld.server.mcp.transport import LocalTransport
from rosld.server.settings import Settings
from tests.server.mcp.model import VERSIONS, Model, model
from tests.waiting import until

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::mcp.MCPDeprecationWarning")]
AIRCRAFT = "/resources/aircraft/"


async def fly(pilot: Model) -> None:
    """Start the aircraft, go fast, come to rest; what is on offer is asked for."""
    start = await pilot.request("start", f"{AIRCRAFT}start")
    await pilot.done("act", **start, reason="Take off")
    speed = await pilot.request("speed", f"{AIRCRAFT}engine/speed")
    await pilot.done("act", **speed, body=200, reason="Cruise")
    flies = await pilot.done("wait", url=speed["url"], until="value >= 150", timeout=60)
    assert flies["met"]
    assert flies["data"] >= 150
    await pilot.done("act", **speed, body=0, reason="Land")
    assert (await pilot.done("wait", url=speed["url"], until="value = 0", timeout=60))["met"]
    await pilot.done("act", method="POST", url=f"{AIRCRAFT}stop", reason="Landed")
    assert (pilot.calls, pilot.read < 4000) == (8, True), pilot.read


async def test_a_model_that_knows_one_url_flies_the_aircraft(serve: Callable[..., Any]) -> None:
    server = serve("aircraft", "--mcp", "write")
    async with model(f"{server.url}mcp") as pilot:
        await fly(pilot)
    assert receipts(server.http) == ["Take off,mcp", "Cruise,mcp", "Land,mcp", "Landed,mcp"]


REASONS = """PREFIX prov: <http://www.w3.org/ns/prov#> PREFIX rdfs: <http://www.w3.org/2000/01/rdf-schema#>
SELECT ?reason ?client { ?write ros:reason ?reason ; prov:startedAtTime ?time ;
    prov:used/prov:wasAttributedTo/rdfs:label ?client } ORDER BY ?time"""


def receipts(http: httpx.Client) -> list[str]:
    """Return reason and client of each receipt, oldest first."""
    return http.post("/sparql", data={"query": REASONS}, headers={"Accept": "text/csv"}).text.splitlines()[1:]


def json_at(http: httpx.Client, path: str, **headers: str) -> Any:
    """Return the JSON at a path."""
    return http.get(path, headers={"Accept": "application/json", **headers}).raise_for_status().json()


async def test_a_model_flies_an_aircraft_that_listens_nowhere() -> None:
    command = StdioServerParameters(command=sys.executable, args=["-m", "rosld", "mcp", "aircraft", "--mcp", "write"])
    async with model(command, VERSIONS[1]) as pilot:
        await fly(pilot)


async def test_a_model_drives_the_rover_sends_it_somewhere_is_refused_and_stops_it(serve: Callable[..., Any]) -> None:
    server = serve("rover", "--mcp", "write")
    async with model(f"{server.url}mcp") as driver:
        found = await driver.done("find", words="camera image_raw")
        camera = next(each["url"] for each in found["data"]["results"] if each["type"] == "sensor_msgs/msg/Image")
        await driver.done("look", url=camera)
        _, picture = driver.last.content
        assert (picture.type, picture.mime_type) == ("image", "image/jpeg")
        twist = {"method": "POST", "url": "/topics/cmd_vel", "body": {"linear": {"x": 0.5}}}
        offered = await driver.done("offers", url="/topics/cmd_vel")
        assert {"PUT", "POST"} <= {each["method"] for each in offered["data"]["do"]}
        await driver.done("act", **twist, for_=2.2, reason="A metre ahead")
        drove = await driver.done("wait", url="/topics/odom", until="pose.pose.position.x >= 0.9", timeout=20)
        assert drove["met"]
        goal = {"method": "POST", "url": "/actions/navigate_to", "body": {"pose": {"pose": {"position": {"x": 1.5}}}}}
        sent = await driver.done("act", **goal, reason="Go on")
        arrived = await driver.done("wait", url=sent["location"], timeout=60)
        assert (arrived["met"], arrived["data"]["status"]) == (True, "succeeded")
        never = await driver.done("wait", url=sent["location"], until="status = 'aborted'", timeout=60)
        assert (never["met"], never["ended"], never["data"]["status"]) == (False, True, "succeeded")
        assert "at most 1" in await driver.refused(
            "act", method="PUT", url="/parameters/rover/max_speed", body=7, reason="Faster"
        )
        await driver.done("stop", reason="Enough")
        assert "stopped" in await driver.refused("act", **twist, reason="Once more")
        assert "person" in await driver.refused("act", method="DELETE", url="/stop", reason="Once more")
        assert (driver.calls, driver.read < 12_000) == (12, True), driver.read


async def test_models_only_read_unless_they_are_allowed_to_write(serve: Callable[..., Any]) -> None:
    server = serve("aircraft")
    async with model(f"{server.url}mcp") as reader:
        start = {"method": "POST", "url": f"{AIRCRAFT}start", "reason": "Take off"}
        assert "--mcp write" in await reader.refused("act", **start)
        plan = await reader.done("act", **start, dry_run=True)
        assert (plan["data"]["dryRun"], "receipt" in plan) == (True, False)
        assert (await reader.done("look", url=AIRCRAFT))["data"] == {"power": "off"}
        stopped = await reader.done("stop", reason="\0 Enough " + "x" * 5000, typo=1)
        assert stopped["data"]["stopped"]


AUTH = """
[[rule]]
agents = ["anna"]
modes = ["read", "control"]
paths = ["/resources/**", "/stop"]
"""


async def test_tokens_decide_what_a_model_may_do(serve: Callable[..., Any], tmp_path: Path) -> None:
    token = "rosld_" + "aB3" * 14 + "x"
    rules = tmp_path / "auth.toml"
    rules.write_text(f'{AUTH}\n[[token]]\nagent = "anna"\nsha256 = "{token_digest(token)}"\n')
    http = (server := serve("aircraft", "--auth", str(rules))).http
    ping = {"json": {"jsonrpc": "2.0", "id": 1, "method": "ping"}}
    assert http.post("/mcp", **ping).status_code == 401
    assert http.post("/mcp", **ping, headers={"Authorization": "Bearer wrong"}).status_code == 401
    client = create_mcp_http_client(headers={"Authorization": f"Bearer {token}"})
    async with client, model(streamable_http_client(f"{server.url}mcp", http_client=client), VERSIONS[1]) as anna:
        await anna.done("act", method="POST", url=f"{AIRCRAFT}start", reason="Take off")
        await anna.refused("look", url="/topics/aircraft/engine/speed")
        await anna.refused("act", method="PUT", url="/data/notes", body={}, reason="Note")
        await anna.done("act", method="POST", url=f"{AIRCRAFT}stop", reason="Land")
    bridge = ["-m", "rosld", "mcp", server.url, "--mcp", "write"]
    command = StdioServerParameters(command=sys.executable, args=bridge, env={**os.environ, "ROSLD_TOKEN": token})
    async with model(command) as anna:
        await anna.done("act", method="POST", url=f"{AIRCRAFT}start", reason="Take off")
        await anna.refused("look", url="/topics/aircraft/engine/speed")
    assert json_at(http, AIRCRAFT, Authorization=f"Bearer {token}") == {"power": "on"}


def test_a_client_at_its_limit_can_still_stop(serve: Callable[..., Any]) -> None:
    http = serve("aircraft", "--limit-loopback", "--setting", "client_rate", "0.5").http
    meta = {
        f"io.modelcontextprotocol/{name}": value
        for name, value in (("protocolVersion", VERSIONS[0]), ("clientCapabilities", {}))
    }
    fields = {
        "Accept": "application/json, text/event-stream",
        "MCP-Protocol-Version": VERSIONS[0],
        "Mcp-Method": "tools/call",
    }

    def call(tool: str, named: str) -> httpx.Response:
        params = {"name": tool, "arguments": {}, "_meta": meta}
        body = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": params}
        return http.post("/mcp", json=body, headers={**fields, "Mcp-Name": named})

    until(lambda: call("find", "find").status_code == 429, "the limit")
    assert call("find", "stop").json()["error"]
    assert call("stop", "stop").json()["result"]["structuredContent"]["data"]["stopped"]


def test_the_endpoint_says_why_it_is_not_there(serve: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    off = serve("aircraft", "--mcp", "off").http.get("/mcp")
    assert off.status_code == 404
    assert "--mcp read" in off.json()["detail"]
    server = serve("aircraft")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    missing = server.http.get("/mcp")
    assert missing.status_code == 404
    assert "pip install 'rosld[mcp]'" in missing.json()["detail"]


def test_the_endpoint_checks_host_and_origin(serve: Callable[..., Any]) -> None:
    http = serve("aircraft").http
    assert http.get("/mcp", headers={"Origin": "http://evil.example"}).status_code == 403
    assert http.get("/mcp", headers={"Host": "evil.example"}).status_code == 421


@pytest.mark.parametrize(
    ("version", "answers", "is_done"),
    [*((version, True, True) for version in VERSIONS), (VERSIONS[0], None, False), (VERSIONS[1], False, False)],
)
async def test_a_person_approves_what_a_pattern_names(
    serve: Callable[..., Any], version: str, answers: bool | None, is_done: bool
) -> None:
    server, asked = serve("aircraft", "--mcp", "write", "--mcp-approve", "/resources/**"), []

    async def answer(context: Any, question: types.ElicitRequestFormParams) -> types.ElicitResult:
        asked.append(question.message)
        return types.ElicitResult(action="accept", content={"approve": answers})

    how = {} if answers is None else {"elicitation_callback": answer}
    async with model(f"{server.url}mcp", version, **how) as pilot:
        await pilot.call("act", method="POST", url=f"{AIRCRAFT}start", reason="Take off")
        assert pilot.last.is_error is not is_done
    assert len(asked) == (answers is not None)
    assert all("Take off" in each for each in asked)
    assert json_at(server.http, AIRCRAFT)["power"] == ("on" if is_done else "off")


@pytest.mark.parametrize("version", VERSIONS)
async def test_resources_are_read_and_changes_are_told(serve: Callable[..., Any], version: str) -> None:
    server = serve("aircraft", "--mcp", "write")
    power, told = f"{server.url}resources/aircraft/power", asyncio.Event()

    async def hear(message: Any) -> None:
        if isinstance(message, types.ResourceUpdatedNotification) and str(message.params.uri) == power:
            told.set()

    async with model(f"{server.url}mcp", version, message_handler=hear) as pilot:
        client = pilot.client
        assert f"{server.url}topics/" in {each.uri for each in (await client.list_resources()).resources}
        (template,) = (await client.list_resource_templates()).resource_templates
        assert template.uri_template == f"{server.url}{{+path}}"
        (content,) = (await client.read_resource(power)).contents
        assert '"off"' in content.text
        with pytest.raises(MCPError):
            await client.read_resource("http://127.0.0.1:1/")
        if version == VERSIONS[0]:
            async with client.listen(resource_subscriptions=[power]) as events:
                await changed(pilot, events.__anext__())
        else:
            await client.subscribe_resource(power)
            await changed(pilot, told.wait())
            await client.unsubscribe_resource(power)


async def changed(pilot: Model, news: Any) -> None:
    """Switch the aircraft on and off until the news have come: the watch begins a moment after the subscription."""
    waiting = asyncio.ensure_future(news)
    for _ in range(30):
        for word in ("start", "stop"):
            await pilot.call("act", method="POST", url=f"{AIRCRAFT}{word}", reason="Change")
            await asyncio.wait({waiting}, timeout=0.5)
            if waiting.done():
                return
    raise AssertionError("nothing was told")


@pytest.mark.parametrize("version", VERSIONS)
async def test_waiting_reports_progress_and_can_be_cancelled(serve: Callable[..., Any], version: str) -> None:
    server, reports = serve("rover", "--setting", "client_streams", "1"), asyncio.Event()

    async def report(progress: float, total: float | None, message: str | None) -> None:
        reports.set()

    async with model(f"{server.url}mcp", version) as driver:
        arguments = {"url": "/topics/odom", "until": "pose.pose.position.x > 50", "timeout": 60}
        waiting = asyncio.ensure_future(driver.client.call_tool("wait", arguments, progress_callback=report))
        await asyncio.wait_for(reports.wait(), 30)
        waiting.cancel()
        await asyncio.wait({waiting})
        assert waiting.cancelled()
        for _ in range(100):  # the one place is free again
            result = await driver.call("wait", **{**arguments, "timeout": 0})
            if not driver.last.is_error:
                break
            await asyncio.sleep(0.1)
        assert result["met"] is False


@pytest.mark.parametrize("version", VERSIONS)
async def test_cancelling_a_call_cancels_the_goal_that_it_sent(version: str) -> None:
    base, asked, accepts, cancelled = "http://robot.example/", asyncio.Event(), asyncio.Event(), asyncio.Event()
    seen: list[tuple[str, str, bytes | None]] = []

    async def robot(scope: Any, receive: Any, send: Any) -> None:
        seen.append((scope["method"], scope["path"], dict(scope["headers"]).get(b"rosld-reason")))
        asked.set()
        if scope["method"] == "POST":
            await accepts.wait()
        location = [(b"location", f"{base}goals/7".encode())]
        await send({"type": "http.response.start", "status": 201, "headers": location})
        await send({"type": "http.response.body"})
        if scope["method"] == "DELETE":
            cancelled.set()

    server = create_server(Space(base), LocalTransport(robot), Settings(mcp="write"))
    async with model(server, version) as pilot:
        goal = {"method": "POST", "url": "/actions/go", "reason": "Go"}
        sending = asyncio.ensure_future(pilot.client.call_tool("act", goal))
        await asked.wait()
        sending.cancel()
        await asyncio.wait({sending})
        accepts.set()
        await asyncio.wait_for(cancelled.wait(), 30)
    why = b"The client cancelled the call that started this."
    assert seen == [("POST", "/actions/go", b"Go"), ("DELETE", "/goals/7", why)]


async def test_large_pictures_are_made_smaller(serve: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rosld.server.mcp.tools._MAX_PICTURE", 1000)
    monkeypatch.setattr("rosld.server.mcp.tools._WIDTH", 80)
    async with model(f"{serve('rover').url}mcp") as reader:
        await reader.done("look", url="/topics/camera/image_raw")
        picture = Image.open(io.BytesIO(base64.b64decode(reader.last.content[1].data)))
    assert picture.size == (80, 60)


async def test_tools_say_what_they_change_and_return(serve: Callable[..., Any]) -> None:
    async with model(f"{serve('aircraft').url}mcp") as pilot:
        tools = {each.name: each for each in (await pilot.client.list_tools()).tools}
    assert list(tools) == ["find", "look", "offers", "query", "wait", "act", "stop"]
    assert [name for name, each in tools.items() if not each.annotations.read_only_hint] == ["act", "stop"]
    assert [name for name, each in tools.items() if each.annotations.destructive_hint] == ["act"]
    assert all(each.output_schema["type"] == "object" for each in tools.values())


async def test_long_results_are_cut_and_say_so(serve: Callable[..., Any]) -> None:
    server = serve("rover", "--setting", "mcp_budget", "600")
    async with model(f"{server.url}mcp") as reader:
        scan = await reader.done("look", url="/topics/scan")
        assert scan["data"]["ranges"][-1] == "... (360 items in all)"
        assert scan["cut"].endswith(f"GET {server.url}topics/scan")
        odometry = await reader.done("look", url="/topics/odom")
        assert {"repeated": 0.0, "times": 6} in odometry["data"]["pose"]["covariance"]
        assert reader.read < 1800


async def test_prompts_contain_the_words_of_the_user(serve: Callable[..., Any]) -> None:
    async with model(f"{serve('aircraft').url}mcp") as pilot:
        assert len((await pilot.client.list_prompts()).prompts) == 4
        prompt = await pilot.client.get_prompt("go_and_wait", {"place": "the kitchen"})
        assert "the kitchen" in prompt.messages[0].content.text
        with pytest.raises(MCPError):
            await pilot.client.get_prompt("go_and_wait", {})
