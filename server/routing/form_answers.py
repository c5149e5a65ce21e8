"""Forms of pages: the write that each means, and where the browser goes after it."""

from __future__ import annotations

from starlette.responses import Response

from rosld.adapters.model import RosError
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError
from rosld.server.auth import enforcement
from rosld.server.auth.redaction import redact_problem
from rosld.server.http.body import FORM
from rosld.server.http.fields import to_uri
from rosld.server.http.problem import Problem
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.pages import InvalidForm, PageRenderer
from rosld.server.rest.resource import Answer, CreatedAnswer, Resource, ShownAnswer
from rosld.server.routing.known_parameters import KnownParameters
from rosld.server.routing.refusals import problem_of_error
from rosld.server.routing.verbs import VERBS
from rosld.server.runtime.dry_run import DryRunEnded, expect_status

_SHOWN_ON_THE_PAGE = frozenset({409, 422, 423, 429, 502, 503, 504})
"""What may become of a form that was in order: the reader stays on its page."""


class FormAnswers:
    """Carries out forms of pages."""

    def __init__(self, pages: PageRenderer, known_parameters: KnownParameters) -> None:
        self._pages = pages
        self._known_parameters = known_parameters

    async def answer(self, exchange: Exchange, resource: Resource) -> Response:
        """A form of one of our pages: the write it means, then the way back to a page (303)."""
        place = enforcement.location_of(exchange.request.scope, self._pages.space)
        try:
            form = await self._pages.read_form(exchange, resource)
            if not exchange.permissions.is_unrestricted:
                enforcement.authorize(exchange.permissions, form.method, place, resource)
            if query_string := exchange.request.scope["query_string"]:
                self._known_parameters.require(form.method, query_string, resource, resource, is_form=True)
            exchange.audit.begin()
            try:
                answer = await VERBS[form.method](resource, exchange)
            except DryRunEnded:
                expect_status(303)
                raise
            except (LoweringError, RosError, Problem) as error:
                problem = redact_problem(problem_of_error(error), exchange.permissions, place)
                if problem.status not in _SHOWN_ON_THE_PAGE:
                    raise
                raise InvalidForm(form, exchange.typed, problem) from error
        except InvalidForm as refusal:
            exchange.audit.set_refusal(refusal.problem.with_quotes, refusal.problem.about)
            return await self._pages.form_errors(resource, refusal, exchange.permissions)
        if isinstance(answer, Response) and answer.status_code == 202 and form.method != "DELETE":
            return await self._pages.with_notice(
                resource, "It was published, but no subscriber was there to get it.", exchange.permissions
            )
        back = _back(resource, answer, self._pages.referring_url(exchange), self._pages.space)
        if form.method == "DELETE" and not (isinstance(answer, Response) and answer.status_code == 202):
            back = resource.url.rstrip("/").rpartition("/")[0] + "/"
        exchange.audit.leads_to_page = True
        return Response(status_code=303, headers={"Location": to_uri(back)})


def is_form(exchange: Exchange, resource: Resource) -> bool:
    """Whether it is a form of one of our pages."""
    return (
        exchange.method == "POST" and resource.takes_forms and (exchange.header("content-type") or "").startswith(FORM)
    )


def _back(resource: Resource, answer: Answer, came_from: str | None, space: Space) -> str:
    """Where a browser goes after a form: to what it made, or back to where it stood, which a cockpit always is."""
    cockpits = space.container("cockpit")
    if came_from is not None and came_from.startswith(cockpits) and not resource.url.startswith(cockpits):
        return came_from
    match answer:
        case CreatedAnswer():
            return answer.location
        case ShownAnswer():
            return answer.resource.url
        case _:
            return answer.headers.get("location") or came_from or resource.url
