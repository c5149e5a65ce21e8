"""Transactions: writes below several routes at once, each validated by its own route, all done or none."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from rosld.server.receipts.audit_context import record_step
from rosld.server.resources.context import Robot
from rosld.server.resources.ldp.validation import validator_of
from rosld.server.storage import Put, Record, Write


async def write_together(robot: Robot, writes: Sequence[Write]) -> Sequence[Record | None]:
    """Do these writes in one transaction, if they are found good. Raises Conflict, Problems and LoweringError."""
    for write in writes:
        record_step(f"{'store' if isinstance(write, Put) else 'delete'} /{write.path}", robot.space.base + write.path)
    judges = [(write, permissions) for write in writes if (permissions := validator_of(robot, write.path)) is not None]
    if not judges:
        return await robot.records.write(*writes)
    turns = {permissions.shape: permissions.lock for _, permissions in judges}
    async with contextlib.AsyncExitStack() as held:
        for shape in sorted(turns):
            await held.enter_async_context(turns[shape])
        sequels = [await permissions.validate(write) for write, permissions in judges]
        records = await robot.records.write(*writes)
        for sequel in sequels:
            sequel()
        return records
