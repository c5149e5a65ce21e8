"""The outcome of a write, as the notice of the page that follows it."""

from __future__ import annotations

from rosld.ontology.describe_activities import Receipt
from rosld.server.html.page import Notice, NoticeLevel, NoticeLink

_STEPS = 3
"""Steps that are told one by one."""


def receipt_notice(receipt: Receipt, link: NoticeLink | None) -> Notice:
    """The notice about a write: what was done, how many it reached, or why it was refused."""
    if receipt.status >= 400:
        return Notice(f"Not done: {receipt.words or 'it was refused'}", NoticeLevel.ERROR, link=link, is_lasting=True)
    steps = "; ".join(receipt.plan[:_STEPS]) or f"{receipt.method} was carried out"
    more = f"; and {len(receipt.plan) - _STEPS} more" if len(receipt.plan) > _STEPS else ""
    if receipt.matched is None:
        return Notice(f"Done: {steps}{more}.", NoticeLevel.GOOD, link=link, is_lasting=True)
    if not receipt.matched:
        return Notice(
            f"Done: {steps}{more}. Nobody was there to get it.", NoticeLevel.WARNING, link=link, is_lasting=True
        )
    whom = "one subscriber" if receipt.matched == 1 else f"{receipt.matched} subscribers"
    return Notice(f"Done: {steps}{more}. It reached {whom}.", NoticeLevel.GOOD, link=link, is_lasting=True)
