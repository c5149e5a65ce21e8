"""The parameters of a Foxglove server."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rosld.adapters.model import NotFound, ParameterValue, Refused, Sent
from rosld.adapters.model import foxglove_protocol as protocol
from rosld.adapters.node_parameters import tree_below

if TYPE_CHECKING:
    from rosld.adapters.foxglove.client import Client


class Parameters:
    """Reads and sets parameters by requests of a client."""

    def __init__(self, client: Client) -> None:
        self._client = client

    async def get(self, names: Sequence[str], until: float) -> Mapping[str, ParameterValue]:
        """Return the current values of parameters, and trees of those below other names."""
        peer = self._client.peer
        known = peer.parameters
        if not names or not peer.can("parameters"):
            return {}
        below = {name: [each for each in known if each.startswith(f"{name.rstrip('/')}/")] for name in names}
        wanted = dict.fromkeys(each for name in names for each in (name, *below[name]) if each != "/")
        values = await self._client.request(
            "getParameters", until, parameterNames=[known[each][0] if each in known else each for each in wanted]
        )
        found: dict[str, ParameterValue] = {}
        for name in names:
            if name in values:
                found[name] = values[name]
            elif inner := {each: values[each] for each in below[name] if each in values}:
                found[name] = tree_below(name, inner)
        return found

    async def set(self, values: Mapping[str, ParameterValue | None], until: float) -> None:
        """Set parameters; None deletes one. Raises Refused naming a parameter that did not change as requested."""
        peer = self._client.peer
        if not peer.can("parameters"):
            raise Refused("the Foxglove server has no parameters")
        known, peer.words = peer.parameters, None
        written = {name: known[name][0] if name in known else name for name in values}
        entries = [protocol.parameter_entry(written[name], value) for name, value in values.items()]
        now = await self._client.request("setParameters", until, parameters=entries)
        for name, value in values.items():
            if value is None:
                known.pop(name, None)
            if now.get(name) != value:
                words = f"the parameter {name} was not {'deleted' if value is None else 'set'}"
                raise Refused(words, words=peer.words, sent=Sent.YES)
        self._client.refresh()

    async def delete(self, names: Sequence[str], until: float) -> None:
        """Delete parameters. Raises NotFound, and Refused if the server does not delete one."""
        for name in names:
            if name not in self._client.peer.parameters:
                raise NotFound(f"there is no parameter {name!r}")
        await self.set(dict.fromkeys(names), until)
