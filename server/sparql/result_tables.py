"""Query results as tables of Arrow: a column a variable, typed if all of its values have one datatype."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from decimal import Decimal
from typing import TYPE_CHECKING, Any

import orjson

from rosld.ontology.literals import date_time_nanoseconds
from rosld.ontology.vocab import xsd
from rosld.server.history.tables import require_pyarrow

if TYPE_CHECKING:
    import pyarrow as pa

_XSD = xsd.string.value.removesuffix("string")
_INTEGER = xsd.integer.value
_INTEGERS = frozenset(
    f"{_XSD}{name}"
    for name in (
        "integer", "long", "int", "short", "byte", "unsignedLong", "unsignedInt", "unsignedShort", "unsignedByte",
        "nonNegativeInteger", "positiveInteger", "nonPositiveInteger", "negativeInteger",
    )
)  # fmt: skip
_DURATION = re.compile(r"(-)?P(?:(\d+)D)?(?:T(?:(\d+)H)?(?:(\d+)M)?(?:(\d+)(?:\.(\d{1,9})0*)?S)?)?", re.ASCII)
_SECOND = 1_000_000_000


def table_of_results(data: bytes) -> pa.Table:
    """Return results in JSON (SPARQL 1.1 Query Results JSON Format) as a table. Slow. Raises NoPyarrow.

    Columns of values of several datatypes, and of those that Arrow lacks, are the values as text.
    """
    require_pyarrow()
    import pyarrow as pa

    results = orjson.loads(data)
    if "boolean" in results:
        return pa.table({"_askResult": [results["boolean"]]})
    rows: Sequence[Mapping[str, Mapping[str, str]]] = results["results"]["bindings"]
    arrays, fields = [], []
    for name in results["head"].get("vars", ()):
        array, datatype = _column([row.get(name) for row in rows])
        arrays.append(array)
        fields.append(pa.field(name, array.type, metadata=None if datatype is None else {"datatype": datatype}))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def _column(cells: Sequence[Mapping[str, str] | None]) -> tuple[pa.Array, str | None]:
    """Return the values of a variable, and their datatype if it is one."""
    import pyarrow as pa

    datatypes = {_datatype(cell) for cell in cells if cell is not None}
    if datatypes <= _INTEGERS and len(datatypes) > 1:
        datatypes = {_INTEGER}
    datatype = datatypes.pop() if len(datatypes) == 1 else None
    texts = [None if cell is None else _text(cell) for cell in cells]
    known = _INTEGER if datatype in _INTEGERS else datatype
    if known in _READERS:
        read, type = _READERS[known]
        try:
            values = [None if text is None else read(text) for text in texts]
            return pa.array(values, None if type is None else pa.type_for_alias(type)), datatype
        except (
            ValueError,
            KeyError,
            ArithmeticError,
            pa.ArrowException,
        ):  # not of its datatype, or beyond the range of Arrow
            pass
    if datatype == xsd.dateTime.value:
        times = [None if text is None else date_time_nanoseconds(text) for text in texts]
        if times.count(None) == texts.count(None) and all(-(2**63) <= (each or 0) < 2**63 for each in times):
            return pa.array(times, pa.int64()).cast(pa.timestamp("ns", "UTC")), datatype
    return pa.array(texts, pa.string()), datatype


def _datatype(cell: Mapping[str, str]) -> str:
    if cell["type"] == "uri":
        return f"{_XSD}anyURI"
    return cell.get("datatype", xsd.string.value)


def _text(cell: Mapping[str, str]) -> str:
    return f"_:{cell['value']}" if cell["type"] == "bnode" else cell["value"]


def _duration(text: str) -> int:
    found = _DURATION.fullmatch(text)
    if found is None:
        raise ValueError(text)
    days, hours, minutes, seconds = (int(found[place] or 0) for place in (2, 3, 4, 5))
    whole = ((days * 24 + hours) * 60 + minutes) * 60 + seconds
    return (whole * _SECOND + int((found[6] or "").ljust(9, "0"))) * (-1 if found[1] else 1)


def _boolean(text: str) -> bool:
    return {"true": True, "1": True, "false": False, "0": False}[text]


_READERS: Mapping[str | None, tuple[Callable[[str], Any], str | None]] = {
    _INTEGER: (int, "int64"),
    xsd.double.value: (float, "float64"),
    xsd.float.value: (float, "float32"),
    xsd.decimal.value: (Decimal, None),
    xsd.boolean.value: (_boolean, "bool"),
    f"{_XSD}date": (date.fromisoformat, "date32"),
    f"{_XSD}dayTimeDuration": (_duration, "duration[ns]"),
}
"""Reader of the text and type of Arrow (None: inferred), by datatype."""
