"""Real servers, whose documents and whose verdicts are held against shapes."""

from __future__ import annotations

from tests.server.conftest import start_server

__all__ = ["start_server"]
