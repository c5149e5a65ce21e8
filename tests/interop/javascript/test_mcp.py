"""The conformance suite of the Model Context Protocol. Scenarios that need tools of the suite's own are named below."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from typing import Any

import pytest

from tests.interop.javascript.node import node

SUITE = "node_modules/@modelcontextprotocol/conformance/dist/index.js"
PATIENCE = 300.0
VERSIONS = ("2025-11-25", "2026-07-28")
FIXTURE = "calls a tool, prompt or resource of the suite's own fixture server"
SKIPPED = {
    "tools-call-(image|audio|embedded-resource|mixed-content|with-logging|with-progress|sampling|elicitation)": FIXTURE,
    "resources-(read-text|read-binary|templates-read|subscribe|unsubscribe)": "reads test:// URIs of the suite's own",
    "prompts-get-.*": FIXTURE,
    "json-schema-2020-12|elicitation-.*|http-custom-header-server-validation|server-sse-polling": FIXTURE,
    "input-required-result-(?!missing|unsupported|ignore|validate).*": FIXTURE,
    "logging-set-level": "the protocol has deprecated logging, and rosld logs nothing to clients",
    "completion-complete": "rosld completes no arguments",
}
"""Scenarios that are not for rosld, and why."""
PARTLY = {
    "sep-2575-server-rejects-undeclared-capability": FIXTURE,
    "sep-2575-missing-capability-http-400": FIXTURE,
}
"""Checks within other scenarios that are not for rosld."""


@pytest.fixture(scope="module")
def tools(start_server: Callable[..., Any]) -> str:
    """The URL of the tools of an aircraft."""
    return f"{start_server('aircraft', '--mcp', 'write').url}mcp"


@pytest.mark.parametrize("version", VERSIONS)
def test_the_scenarios_for_any_server_pass(tools: str, version: str) -> None:
    command = node(SUITE, "server", "--url", tools, "--suite", "all", "--spec-version", version)
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    words = done.stdout + done.stderr
    results = dict(re.findall(r"^[✓✗] ([\w-]+): \d+ passed, (\d+) failed", words, re.MULTILINE))
    assert len(results) > 30, words[-3000:]
    failed = {name: int(count) for name, count in results.items() if int(count) and not is_skipped(name)}
    allowed = {"server-stateless": len(PARTLY)} if version == VERSIONS[1] else {}
    assert failed == allowed, words[-5000:]


def is_skipped(name: str) -> bool:
    return any(re.fullmatch(pattern, name) for pattern in SKIPPED)
