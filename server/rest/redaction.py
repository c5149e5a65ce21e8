"""States as they may be seen: made once for all agents with the same rights, and kept with the state itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from rosld.ontology.document import Document
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.redaction import redact_document
from rosld.server.hypermedia.redaction import veiled_view
from rosld.server.rest.state import State


def veiled_state(
    state: State,
    permissions: Permissions,
    document: Callable[[], Document] | None = None,
    plain: Callable[[], bytes] | None = None,
) -> State:
    """The state without what the agent may not know of; it has the same name, so that it guards writes all the same.

    `document` and `plain` stand for its own, where less of these is to be seen from the beginning.
    """

    def described() -> Document:
        return redact_document(state.document if document is None else document(), permissions)

    is_for_worker = state.is_large and document is None
    return replace(
        state,
        describe=partial(_veiled_document, state.describe, permissions) if is_for_worker else described,
        plain=state.plain if plain is None else plain,
        token=state.tag,
        view=None if state.view is None else veiled_view(state.view, permissions),
        renderings={},
        veils={},
    )


def _veiled_document(describe: Callable[[], Document], permissions: Permissions) -> Document:
    return redact_document(describe(), permissions)
