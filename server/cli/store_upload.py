"""`rosld lift --into URL`: send recordings to a store by the SPARQL 1.1 Graph Store Protocol, in parallel."""

from __future__ import annotations

import base64
import hashlib
import os
import random
import re
import time
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from msgspec.structs import replace

from rosld.adapters.base import Recording
from rosld.ontology.urls import Space
from rosld.server.cli.conversion import Output, convert
from rosld.server.cli.failure import Failure, output_errors
from rosld.server.cli.lift import LiftJob
from rosld.server.cli.parts import Outcome, Part
from rosld.server.cli.rdf_writer import Lifting
from rosld.server.dataset.endpoint_client import Endpoint, StoreError, StoreRefused

_SECONDS = 300.0
"""Maximum seconds of a request: a store may index a megabyte of statements meanwhile."""
_TRIES = 7
_LONGEST_PAUSE = 30.0
_PASSING = frozenset({408, 425, 429, 500, 502, 503, 504})
"""HTTP statuses after which the same request may succeed."""
_BLANK = re.compile(rb"(^|> )_:(l[0-9a-f]{20}-[0-9]+)(?= [<.])", re.MULTILINE)


class UploadJob(LiftJob, frozen=True, kw_only=True):
    """To send lifted messages to the URL of a store, a request per block."""

    url: str
    authorization: str | None

    @property
    def identity(self) -> str:
        return repr(replace(self, authorization=None))

    def make(self, recording: Recording, part: Part, block: int, folder: Path, *, simulated_time: bool) -> Outcome:
        space = Space(self.base, self.settings.types)
        lifting = Lifting(recording, space, self.settings, simulated_time=simulated_time)
        # With blank nodes, a request that is repeated would add their statements again (RDF 1.1 3.5).
        name = rb"\1<%s.well-known/genid/\2>" % self.base.encode().replace(b"\\", rb"\\")
        endpoint = Endpoint(self.url, self.authorization, seconds=_SECONDS)
        try:
            for texts in self.blocks(lifting, part, block):
                if body := b"".join(texts):
                    _send(endpoint, _BLANK.sub(name, body), self.target.syntax.media_type)
        finally:
            endpoint.close()
        return Outcome(lifting.selected, dict(lifting.unread))


def _send(endpoint: Endpoint, body: bytes, media_type: str) -> None:
    """Send a request, again after a pause if the store is busy or away. Raises Failure."""
    for attempt in range(_TRIES):
        try:
            endpoint.post(body, media_type, "*/*")
            return
        except StoreError as error:
            is_final = isinstance(error, StoreRefused) and error.status not in _PASSING
            if is_final or attempt == _TRIES - 1:
                raise Failure(str(error)) from error
        time.sleep(min(2**attempt, _LONGEST_PAUSE) * random.uniform(0.5, 1))


def destination(url: str, graph: str | None, token: str | None) -> tuple[str, str | None]:
    """Return the URL of requests and the Authorization header. Raises ValueError for an invalid URL.

    USER:PASSWORD@ in the URL is Basic (RFC 7617), a token is Bearer (RFC 6750).
    """
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise ValueError(f"--into {url}: it must be the URL of a store, such as http://localhost:7878/store")
    authorization = None if token is None else f"Bearer {token}"
    if parts.username is not None:
        pair = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        authorization = f"Basic {base64.b64encode(pair.encode()).decode()}"
    place = parts._replace(netloc=parts.netloc.rpartition("@")[2], fragment="").geturl()
    if graph is not None:
        place += f"{'&' if parts.query else '?'}graph={quote(graph, safe='')}"
    return place, authorization


def state_folder(identity: str) -> Path:
    """Return the folder that notes what was sent, below XDG_STATE_HOME."""
    home = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(home, "rosld", f"lift-{hashlib.sha256(identity.encode()).hexdigest()[:16]}")


def upload(inputs: Sequence[str], types: Sequence[Path], job: UploadJob, workers: int | None, dask: str | None) -> None:
    """Send recordings to a store. Raises Failure."""
    folder = state_folder(f"{job.identity} {[*inputs]} {Path.cwd()}")
    with output_errors():
        folder.parent.mkdir(parents=True, exist_ok=True)
    convert(inputs, types, job, StoreOutput(job.url), folder, workers, dask)


class StoreOutput(Output):
    """A store, to which the workers have sent the parts."""

    def __init__(self, name: str) -> None:
        self.name = name
