"""Error responses: the exceptions of handlers as answers."""

from __future__ import annotations

import asyncio
import logging
from urllib.parse import quote

from starlette.responses import Response

from rosld.adapters.model import RosError
from rosld.ontology.body import BodyError
from rosld.ontology.lower import LoweringError
from rosld.ontology.urls import Space
from rosld.server.auth import enforcement
from rosld.server.auth.agent import ANONYMOUS
from rosld.server.auth.rate_limit import RETRY_SECONDS, RateLimitExceeded
from rosld.server.auth.redaction.problems import redact_problem
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render
from rosld.server.http.token_redaction import redact_tokens
from rosld.server.middleware.handler import Handler
from rosld.server.middleware.rate_limits import Admission
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.ros_problems import problem_of, problem_of_body, problem_of_out_of_memory
from rosld.server.runtime.process_memory import is_out_of_memory
from rosld.server.sparql.protocol import UPDATE_MEDIA_TYPE
from rosld.server.storage.record import StorageError

_log = logging.getLogger("rosld")


class ErrorResponses:
    """Answers what is raised with a page or problem details (RFC 9457) that say what the agent may know."""

    def __init__(self, next: Handler, admission: Admission, pages: PageRenderer, space: Space) -> None:
        self._next = next
        self._admission = admission
        self._pages = pages
        self._space = space

    async def __call__(self, exchange: Exchange) -> Response:
        """Answer as the next handler does, or tell what it raises."""
        try:
            return await self._next(exchange)
        except Exception as raised:
            error = self._admission.count_refused(exchange, raised)
            if isinstance(error, RateLimitExceeded):
                await asyncio.sleep(RETRY_SECONDS)
            return self._failure(exchange, error)

    def _failure(self, exchange: Exchange, error: Exception) -> Response:
        """The response that tells of an error. What nobody foresaw is logged in full and told in one sentence."""
        scope = exchange.request.scope
        if isinstance(error, RosError):
            error = problem_of(error)
        elif isinstance(error, BodyError | LoweringError):
            error = problem_of_body(error)
        elif isinstance(error, StorageError):
            error = Problem(507, str(error)) if error.full else Problem(503, str(error), headers={"Retry-After": "1"})
        elif is_out_of_memory(error):
            _log.error("%s %s: %s", exchange.method, scope["path"], error or "no memory is left")
            error = problem_of_out_of_memory(error, is_write=self._would_write(exchange))
        if not isinstance(error, Problem):
            _log.exception("%s %s failed", exchange.method, scope["path"], exc_info=error)
            error = Problem(500, "The server failed on this request; its log says more.")
        error = redact_problem(error, exchange.permissions, enforcement.location_of(scope, self._space))
        self._tell_release(error, exchange)
        exchange.audit.set_refusal(error.with_quotes, error.about)
        path = quote(scope["raw_path"].lstrip(b"/"), safe="/%:@!$&'()*+,;=~")
        url = redact_tokens(self._space.base + path)
        return self._pages.problem(exchange, error, url) or render(error, exchange.accept, url=url).response()

    def _tell_release(self, error: Problem, exchange: Exchange) -> None:
        """Tell an agent who may release the stop how, and nobody else."""
        if error.status != 423 or not exchange.permissions.may("DELETE", self._space.stop):
            return
        if exchange.agent == ANONYMOUS:
            error.detail += f" A person can release the stop at {self._space.stop}."
        else:
            error.detail += f" DELETE of {self._space.stop} releases the stop."

    def _would_write(self, exchange: Exchange) -> bool:
        """Whether a request is a write, as far as it was read: of a form for `/sparql`, only its content tells."""
        if exchange.audit.is_write or exchange.method in ("PUT", "PATCH"):
            return True
        is_write = enforcement.is_write(exchange.method, enforcement.location_of(exchange.request.scope, self._space))
        return exchange.essence == UPDATE_MEDIA_TYPE or is_write
