"""`rosld query`: SPARQL over a source that is opened here, or over a running server."""

from __future__ import annotations

import asyncio
import os
import sys
import urllib.error
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click
import orjson

from rosld.adapters.registry import adapter_for
from rosld.server.cli.failure import ExitCode, Failure, only_errors, user_errors
from rosld.server.cli.tables import print_table
from rosld.server.mcp.transport import Caller, LocalTransport
from rosld.server.rest.formats import COLUMNS
from rosld.server.serving.lifespan import lifespan
from rosld.server.settings import Settings, canonical_base

TOKEN = "ROSLD_TOKEN"
"""Environment variable with the access token for a running server."""
_SOLUTIONS = "application/sparql-results+json"
_PROBLEM = "application/problem+json;q=0.9"
_ACCEPT: Mapping[str, str] = {
    "csv": f"text/csv, text/turtle;q=0.5, {_PROBLEM}",
    "tsv": f"text/tab-separated-values, text/turtle;q=0.5, {_PROBLEM}",
    "json": f"{_SOLUTIONS}, application/ld+json;q=0.5, {_PROBLEM}",
    "table": f"{_SOLUTIONS}, text/turtle;q=0.5, {_PROBLEM}",
    **{name: f"{media_type}, {_PROBLEM}" for name, media_type in COLUMNS.items()},
}
_MAX_BODY = 1 << 40
TIME_LIMIT = "600"
"""Seconds for a query that is answered here: nobody else waits for it."""


class Answer(NamedTuple):
    """Result of a query in some media type."""

    media_type: str
    body: bytes


def query(source: str, text: str, format: str | None, settings: Settings) -> None:
    """Print the result of a query in a format, by default a table on a terminal and CSV elsewhere. Raises Failure."""
    format = format or ("table" if sys.stdout.isatty() else "csv")
    if format in COLUMNS and sys.stdout.isatty():
        raise Failure(f"--format {format} writes bytes: redirect them to a file or a pipe", ExitCode.USAGE)
    answer = ask(source, query_text(text), _ACCEPT[format], settings)
    if format == "table" and answer.media_type == _SOLUTIONS:
        _print(orjson.loads(answer.body), settings.base_url)
    else:
        click.echo(answer.body, nl=format not in COLUMNS and not answer.body.endswith(b"\n"))


def query_text(text: str) -> str:
    """Return the text of a query: that of the file for `@FILE`. Raises Failure."""
    if not text.startswith("@"):
        return text
    with user_errors():
        return sys.stdin.read() if text == "@-" else Path(text[1:]).read_text("utf-8")


async def solutions(source: str, text: str, settings: Settings) -> dict[str, Any]:
    """Return the solutions of a SELECT query, as in SPARQL Query Results JSON. Raises Failure and as `Adapter.open`."""
    answer = await _ask_here(source, text, f"{_SOLUTIONS}, {_PROBLEM}", settings)
    found: dict[str, Any] = orjson.loads(answer.body)
    return found


def ask(source: str, text: str, accept: str, settings: Settings) -> Answer:
    """Return the answer of a running server (a URL), or of a source that is opened here. Raises Failure."""
    if source.startswith(("http://", "https://")):
        return _ask_server(source, text, accept)
    with user_errors(ExitCode.USAGE):
        return asyncio.run(_ask_here(source, text, accept, settings))


async def _ask_here(source: str, text: str, accept: str, settings: Settings) -> Answer:
    from rosld.server.app import create_app

    adapter = adapter_for(source, settings.adapter_options)
    app = create_app(adapter, settings)
    try:
        with only_errors():
            async with lifespan(app):
                await adapter.wait_for_recordings()
                fields = (("content-type", "application/sparql-query"), ("accept", accept))
                sending = LocalTransport(app, _MAX_BODY).send
                answer = await sending(Caller(), "POST", f"{settings.base_url}sparql", fields, text.encode())
                app.end_streams()
    finally:
        await adapter.close()
    body = answer.body or b""
    if answer.status != 200:
        raise _failure(answer.status, body)
    return Answer((answer.field("content-type") or "").partition(";")[0], body)


def _ask_server(url: str, text: str, accept: str) -> Answer:
    with user_errors(ExitCode.USAGE):
        endpoint = f"{canonical_base(url)}sparql"
    headers = {"Content-Type": "application/sparql-query", "Accept": accept}
    if token := os.environ.get(TOKEN):
        headers["Authorization"] = f"Bearer {token}"
    request = urllib.request.Request(endpoint, text.encode(), headers)
    try:
        with urllib.request.urlopen(request) as response:
            return Answer(response.headers.get_content_type(), response.read())
    except urllib.error.HTTPError as error:
        raise _failure(error.code, error.read()) from error
    except OSError as error:
        raise Failure(f"{endpoint} cannot be reached: {error}", ExitCode.UNREACHABLE) from error


def _failure(status: int, body: bytes) -> Failure:
    """Return the failure for problem details: a wrong query, or an answer beyond the limits."""
    try:
        words = str(orjson.loads(body)["detail"])
    except (ValueError, KeyError, TypeError):
        words = body.decode("utf-8", "replace")[:500] or f"the server answered with status {status}"
    code = ExitCode.USAGE if status in (400, 406, 415, 422) else ExitCode.INCOMPLETE
    return Failure(words, ExitCode.FAILED if status in (401, 403, 404) else code)


def _print(found: dict[str, Any], base: str) -> None:
    """Print solutions as a table, URLs below the base without it; the value of an ASK query as a word."""
    if "boolean" in found:
        click.echo(str(found["boolean"]).lower())
        return
    names = found["head"]["vars"]
    rows = [[_cell(row.get(name), base) for name in names] for row in found["results"]["bindings"]]
    numeric = {name for at, name in enumerate(names) if rows and all(_is_number(row[at]) for row in rows)}
    print_table(names, rows, frozenset(numeric))


def _cell(term: Mapping[str, str] | None, base: str) -> str:
    if term is None:
        return ""
    value = " ".join(term["value"].split())
    return value.removeprefix(base) or "/" if term["type"] == "uri" else value


def _is_number(text: str) -> bool:
    try:
        float(text or 0)
    except ValueError:
        return False
    return True
