"""Transactions: writes below several routes at once, each validated by its own route, all done or none."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from rosld.server.receipts.audit_context import record_step
from rosld.server.resources.ldp.documents import Documents
from rosld.server.storage.record import Put, Record, Write


async def write_together(documents: Documents, writes: Sequence[Write]) -> Sequence[Record | None]:
    """Do these writes in one transaction, if they are found good. Raises Conflict, Problems and LoweringError."""
    for write in writes:
        record_step(
            f"{'store' if isinstance(write, Put) else 'delete'} /{write.path}", documents.space.base + write.path
        )
    judges = [
        (write, permissions) for write in writes if (permissions := documents.validator_of(write.path)) is not None
    ]
    if not judges:
        return await documents.records.write(*writes)
    turns = {permissions.shape: permissions.lock for _, permissions in judges}
    async with contextlib.AsyncExitStack() as held:
        for shape in sorted(turns):
            await held.enter_async_context(turns[shape])
        sequels = [await permissions.validate(write) for write, permissions in judges]
        records = await documents.records.write(*writes)
        for sequel in sequels:
            sequel()
        return records
