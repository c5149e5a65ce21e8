"""Responses to writes: representations as preferred (RFC 7240 4.2), pages after forms, and dry runs."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from difflib import get_close_matches

import orjson
from msgspec.structs import replace
from starlette.responses import Response

from rosld.adapters.model import Graph, RosError
from rosld.ontology.body import BodyError
from rosld.ontology.lift import LiftSettings
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError
from rosld.server.auth import enforcement
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.redaction import redact_problem
from rosld.server.http.body import FORM
from rosld.server.http.fields import Link, render_links, to_uri
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import MessageSchemas
from rosld.server.rest.exchange import Exchange, query_pairs
from rosld.server.rest.pages import InvalidForm, PageRenderer
from rosld.server.rest.path_item import FORMAT, OF_EVERY_WRITE, PathItem
from rosld.server.rest.resource import LDP, Answer, CreatedAnswer, Resource, ShownAnswer
from rosld.server.rest.responses import ACCEPT_FIELDS, RawResponse
from rosld.server.rest.ros_problems import problem_of, problem_of_body
from rosld.server.rest.state import Rendering, State
from rosld.server.robot.session import Session
from rosld.server.routing.representations import Representations
from rosld.server.runtime.dry_run import DryRun, DryRunEnded, PlannedStep, current_dry_run, expect_status
from rosld.server.storage.record import StorageError

VERBS: Mapping[str, Callable[[Resource, Exchange], Awaitable[Answer]]] = {
    "PUT": lambda resource, exchange: resource.put(exchange),
    "POST": lambda resource, exchange: resource.post(exchange),
    "PATCH": lambda resource, exchange: resource.patch(exchange),
    "DELETE": lambda resource, exchange: resource.delete(exchange),
}
"""Function of each method."""


def refuse_partial_put(exchange: Exchange) -> None:
    """Raise a 400 Problem for a PUT of a part (RFC 9110 14.5), which would replace the whole."""
    if exchange.method == "PUT" and exchange.header("content-range") is not None:
        raise Problem(400, "PUT with Content-Range is not supported: send the whole resource, or PATCH.")


def check_media_type(exchange: Exchange, resource: Resource) -> None:
    """Raise a 415 Problem with the accepted media types (RFC 9110 12.5.1) for the body of a request."""
    accepted = resource.accepts.get(exchange.method)
    if accepted is None:
        return
    if exchange.header("content-type") is None and exchange.header("content-length") in (None, "0"):
        return
    if "*/*" in accepted and exchange.essence is not None:
        return
    if exchange.media_type not in accepted:
        headers = {ACCEPT_FIELDS[exchange.method]: ", ".join(accepted)}
        raise Problem(
            415, f"{exchange.method} accepts {', '.join(accepted)} here, not {exchange.media_type}.", headers=headers
        )


_REFUSED_BODIES = frozenset({400, 409, 415, 422})


def problem_of_error(error: BodyError | LoweringError | RosError | Problem) -> Problem:
    """Return the problem details (RFC 9457) of an error that a resource raises."""
    if isinstance(error, Problem):
        return error
    return problem_of(error) if isinstance(error, RosError) else problem_of_body(error)


def with_constraint_link(resource: Resource, error: BodyError | LoweringError | Problem) -> Problem:
    """Return the refusal of a body with a link to its constraints (LDP 4.2.1.6)."""
    problem = error if isinstance(error, Problem) else problem_of_body(error)
    if problem.status in _REFUSED_BODIES and resource.constrained_by is not None:
        problem.headers["Link"] = render_links([Link(resource.constrained_by, f"{LDP}constrainedBy")])
    return problem


def with_type_links(resource: Resource, problem: Problem) -> Problem:
    """Return a refusal with the links of the resource, each once; a missing resource has none."""
    if problem.status not in (404, 410) and resource.links:
        there = problem.headers.get("Link", "")
        links = render_links([each for each in resource.links if str(each) not in there])
        problem.headers["Link"] = ", ".join(each for each in (links, there) if each)
    return problem


_LONGEST = 100
"""Maximum number of characters of a parameter that are repeated in the refusal."""
_RECEIPT = "receipt"
"""Parameter of the page after a form."""
_UNTIL = "until"
"""Accepted here even without a value that a condition could concern: it is refused elsewhere, with a better message."""
OFFER = "offer"
"""Parameter that requests the offer of a resource."""
_MAX_REMEMBERED = 4096
"""Maximum number of cached requests: finding the parameters of a path item takes 50 to 100 us, a third of a read."""


class KnownParameters:
    """Check that refuses undeclared query parameters, and repeated ones that are not lists."""

    def __init__(self, lifting: LiftSettings) -> None:
        self._schemas = MessageSchemas(lambda ref: None, lifting)
        self._accepted: set[tuple[str, bool, str, str, tuple[str, ...]]] = set()

    def require(
        self, method: str, query_string: bytes, target: Resource, resource: Resource, *, is_form: bool = False
    ) -> None:
        """Raise a 400 Problem for a parameter that neither resource declares for the method of a request.

        `target` is the resource at the path, `resource` its variant that answers: a method that it does not have is a
        404 or 405 regardless of the parameters. A form is sent to the URL of its page, and may have the parameters of
        that.
        """
        if method in resource.passes_unknown_parameters or method in target.passes_unknown_parameters:
            return
        names = _names(query_string)
        request = (method, is_form, target.url, resource.url, names)
        if request in self._accepted or method not in resource.methods():
            return
        is_read = method in ("GET", "HEAD")
        known = dict.fromkeys((each.name for each in ((FORMAT,) if is_read else OF_EVERY_WRITE)), False)
        for item in (each.path_item(self._schemas) for each in dict.fromkeys((target, resource))):
            known |= {each.name: each.is_list for each in item.write(method).query}
            if is_form or is_read:
                known |= _of_page(item)
        _require(method, names, known)
        if len(self._accepted) >= _MAX_REMEMBERED:
            self._accepted.clear()
        self._accepted.add(request)


def _names(query_string: bytes) -> tuple[str, ...]:
    """Return the names of the parameters of a query string. Raises a 400 Problem."""
    return tuple(name for name, _ in query_pairs(query_string))


def _of_page(item: PathItem) -> dict[str, bool]:
    """Return the parameters of GET, and whether each may be repeated."""
    anywhere = dict.fromkeys((_RECEIPT, _UNTIL, OFFER, *item.shared_query), False)
    return {**anywhere, **{each.name: each.is_list for each in item.query}}


def _require(method: str, names: Sequence[str], known: Mapping[str, bool]) -> None:
    """Raise a 400 Problem for a parameter that is unknown, or repeated without being a list."""
    for place, name in enumerate(names):
        shown = name[:_LONGEST]
        if name not in known:
            nearest = get_close_matches(shown, known, n=1, cutoff=0.0)[0]
            there = ", ".join(f"?{each}" for each in sorted(known))
            words = f"{method} has no parameter ?{shown} here; the nearest is ?{nearest}. There are {there}."
            raise Problem(400, words)
        if name in names[:place] and not known[name]:
            raise Problem(400, f"?{shown} is given more than once: send it once.")


class WriteAnswers:
    """Responses to completed writes."""

    def __init__(self, representations: Representations) -> None:
        self._representations = representations

    async def created(self, exchange: Exchange, resource: Resource, created: CreatedAnswer) -> Response:
        """Return a 201 with the new resource as body (RFC 9110 15.3.2), or without if preferred.

        It also has the type links of the resource to which the request was sent (LDP 5.2.1.4).
        """
        headers = [(b"location", to_uri(created.location).encode("ascii"))]
        is_member = created.location != resource.url
        links, rendering = created.links, None
        if created.state is not None and not exchange.prefer.minimal:
            rendering = await self._outcome(exchange, created.resource, created.state, answer=is_member)
        if rendering is None:
            links = (*(resource if is_member else created.resource).links, *links)
            if links:
                headers.append((b"link", render_links(links).encode("latin-1")))
            headers.append((b"content-length", b"0"))
            if exchange.prefer.minimal:
                headers.append((b"preference-applied", b"return=minimal"))
            return RawResponse(201, b"", headers)
        if is_member:
            types = (replace(each, anchor=resource.url) for each in resource.links if each.rel == "type")
            links = (*links, *types)
        if links:
            headers.append((b"link", render_links(links).encode("latin-1")))
        return RawResponse(201, rendering.body, [*rendering.headers, *headers, (b"content-location", headers[0][1])])

    async def shown(self, exchange: Exchange, shown: ShownAnswer) -> Response:
        """Return a 200 with the representation of the outcome (RFC 9110 8.7), or a 204 if preferred."""
        location = (b"content-location", to_uri(shown.resource.url).encode("ascii"))
        added = [(b"link", render_links(shown.links).encode("latin-1"))] if shown.links else []
        if exchange.prefer.minimal:
            return RawResponse(204, b"", [location, *added, (b"preference-applied", b"return=minimal")])
        rendering = await self._outcome(exchange, shown.resource, shown.state)
        if rendering is None:
            return RawResponse(204, b"", [location, *added])
        headers = rendering.headers
        if exchange.method == "PUT":  # the body sent is not the stored one (RFC 9110 9.3.4)
            headers = [each for each in headers if each[0] != b"etag"]
        return RawResponse(200, rendering.body, [*headers, location, *added])

    async def as_preferred(self, exchange: Exchange, resource: Resource, response: Response) -> Response:
        """Replace an empty 204 by the representation if the request prefers it (RFC 7240 4.2)."""
        if not exchange.prefer.representation or response.status_code != 204 or exchange.method == "DELETE":
            return response
        rendering = await self._outcome(exchange, resource)
        if rendering is None:
            return response
        headers = [*rendering.headers, (b"preference-applied", b"return=representation")]
        headers.append((b"content-location", to_uri(resource.url).encode("ascii")))
        if "link" in response.headers:
            headers.append((b"link", response.headers["link"].encode("latin-1")))
        return RawResponse(200, rendering.body, headers)

    async def _outcome(
        self, exchange: Exchange, resource: Resource, state: State | None = None, *, answer: bool = False
    ) -> Rendering | None:
        """Return the representation after a write; None if it is unavailable, not preferred, or not readable.

        A resource that the agent may not read is only shown if it is the `answer` to the request, such as a call.
        """
        if not answer and not exchange.permissions.may_read(resource.url):
            return None
        try:
            return await self._representations.preferred(
                exchange, resource, await resource.state() if state is None else state
            )
        except (Problem, RosError, StorageError):
            return None


_SHOWN_ON_THE_PAGE = frozenset({409, 422, 423, 429, 502, 503, 504})
"""Statuses of valid forms that are answered on the same page."""


async def answer_form(
    pages: PageRenderer, known_parameters: KnownParameters, exchange: Exchange, resource: Resource
) -> Response:
    """Handle a form of one of our pages: the write that it stands for, then a redirect to a page (303)."""
    place = enforcement.location_of(exchange.request.scope, pages.space)
    try:
        form = await pages.read_form(exchange, resource)
        if not exchange.permissions.is_unrestricted:
            enforcement.authorize(exchange.permissions, form.method, place, resource)
        if query_string := exchange.request.scope["query_string"]:
            known_parameters.require(form.method, query_string, resource, resource, is_form=True)
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
        return await pages.form_errors(resource, refusal, exchange.permissions)
    if isinstance(answer, Response) and answer.status_code == 202 and form.method != "DELETE":
        return await pages.with_notice(resource, "It was published, but had no subscriber.", exchange.permissions)
    back = _back(resource, answer, pages.referring_url(exchange), pages.space)
    if form.method == "DELETE" and not (isinstance(answer, Response) and answer.status_code == 202):
        back = resource.url.rstrip("/").rpartition("/")[0] + "/"
    exchange.audit.leads_to_page = True
    return Response(status_code=303, headers={"Location": to_uri(back)})


def is_form(exchange: Exchange, resource: Resource) -> bool:
    """Whether a request is a form of one of our pages."""
    return (
        exchange.method == "POST" and resource.takes_forms and (exchange.header("content-type") or "").startswith(FORM)
    )


def _back(resource: Resource, answer: Answer, referrer: str | None, space: Space) -> str:
    """Return the target after a form: the created resource, or the page of the form (always for a cockpit)."""
    cockpits = space.container("cockpit")
    if referrer is not None and referrer.startswith(cockpits) and not resource.url.startswith(cockpits):
        return referrer
    match answer:
        case CreatedAnswer():
            return answer.location
        case ShownAnswer():
            return answer.resource.url
        case _:
            return answer.headers.get("location") or referrer or resource.url


async def answer_dry_run(
    exchange: Exchange, resource: Resource, session: Session, answer: Callable[[], Awaitable[Response]]
) -> Response:
    """Answer a write by `answer` in a dry run: 200 with the plan as JSON, or the refusal of the write.

    Raises what `answer` raises.
    """
    dry_run = DryRun()
    token = current_dry_run.set(dry_run)
    try:
        answered = await answer()
        if answered.status_code >= 400:  # a form, shown again on its page
            return answered
        dry_run.status = answered.status_code
    except DryRunEnded:
        dry_run.status = dry_run.status or _only_status(resource, exchange.method, session)
    finally:
        current_dry_run.reset(token)
    plan = {
        "dryRun": True,
        "method": exchange.method,
        "url": resource.url,
        "steps": [*_steps(dry_run, resource.url, session, exchange.permissions)],
        "limits": [*filter(exchange.permissions.may_read, dry_run.limits)],
        "conditions": [*filter(exchange.permissions.may_read, dry_run.conditions)],
        "status": dry_run.status,
    }
    body = orjson.dumps(plan, option=orjson.OPT_INDENT_2)
    return Response(body, 200, {"Cache-Control": "no-store"}, "application/json")


def _only_status(resource: Resource, method: str, session: Session) -> int | None:
    """Return the status of success of a method, None if it has several."""
    item = resource.path_item(MessageSchemas(lambda ref: None, session.lifting))
    statuses = item.write(method).statuses(method)
    return statuses[0] if len(statuses) == 1 else None


def _steps(dry_run: DryRun, url: str, session: Session, permissions: Permissions) -> Iterator[dict[str, object]]:
    """Yield the steps that an agent may know of, with the URLs of the nodes that each would reach."""
    space, graph = session.space, session.graph
    for step in dry_run.steps:
        about = step.touches[0] if step.touches else url
        if about != url and not all(map(permissions.may_read, step.touches)):
            continue
        nodes = (space.node(name) for name in _receivers(step, space, graph))
        yield {"does": step.description, "url": about, "receivers": [*filter(permissions.may_read, nodes)]}


def _receivers(step: PlannedStep, space: Space, graph: Graph) -> list[str]:
    """Return the nodes that a step would reach: subscribers of a topic, providers of a service or an action, owners."""
    found: list[str] = []
    for url in step.touches:
        location = space.location(url)
        if location is None:
            continue
        name = location.name
        match location.kind:
            case "topics" if name in graph.topics:
                found += (endpoint.node for endpoint in graph.topics[name].subscribers)
            case "services" if name in graph.services:
                found += graph.services[name].providers
            case "actions" if name in graph.actions:
                found += graph.actions[name].servers
            case "nodes":
                found.append(name)
            case "parameters" if name in graph.parameters:
                found += filter(None, (graph.parameters[name].node,))
    return [node for node in dict.fromkeys(found) if node != graph.own_node]
