"""A trip on the terminal: its reasons, and the seconds around it as one line of blocks for each measured field."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeGuard, cast

_BLOCKS = "▁▂▃▄▅▆▇█"
_NONE, _EMPTY = "×", " "
_WIDTH = 61  # odd: the trip is in the middle of a whole excerpt
_MOST_FIELDS = 24

Line = tuple[str, str, str]


def trip_lines(trip: Mapping[str, Any], start_ns: int) -> Iterable[Line]:
    """Return lines of a log's page as (name, text, style).

    The contents of a file are arbitrary: values of the wrong type are left out.

    Args:
        trip: the event.
        start_ns: the log's first time.
    """
    speed = trip.get("speed_rpm")
    rotor = f", rotor {speed:.0f} rpm" if _is_number(speed) else ""
    yield "trip", f"{(trip['time_ns'] - start_ns) * 1e-9:11.3f} s{rotor}", "bold red"
    for reason in map(_table, _list(trip.get("reasons"))):
        after = reason.get("after_ms")
        when = f" ({after:.0f} ms later)" if _is_number(after) and after else ""
        yield "  reason", f"{reason.get('interlock', '')}: {reason.get('text', '')}{when}", "red"
    if later := _list(trip.get("later")):
        yield "  after it", ", ".join(map(str, later)), "yellow"
    from_ms, until_ms = trip.get("from_ms"), trip.get("until_ms")
    if _is_number(from_ms) and _is_number(until_ms) and from_ms < until_ms:
        yield from _plots(trip.get("excerpt"), from_ms, until_ms)


def _plots(excerpt: object, from_ms: float, until_ms: float) -> Iterable[Line]:
    shown = 0
    for topic, fields in _table(excerpt).items():
        for name, series in _table(fields).items():
            points = _points(series)
            numbers = [value for _, value in points if value is not None]
            if shown == _MOST_FIELDS or not _moves(name, numbers):
                continue
            shown += 1
            low, high = min(numbers), max(numbers)
            yield f"  {topic}", f"{sparkline(points, from_ms, until_ms)} {name} {low:.4g} … {high:.4g}", ""
    if shown:
        before = round((_WIDTH - 1) * -from_ms / (until_ms - from_ms))
        yield "", f"{'':{max(0, min(before, _WIDTH - 1))}}↑ {from_ms * 1e-3:g} s … {until_ms * 1e-3:g} s", "dim"


def _moves(name: str, numbers: Sequence[float]) -> bool:
    """Return whether a field is drawn: it has a unit in its name, as measured quantities have, and over two points."""
    return len(numbers) > 2 and name.endswith(("_m", "_rad", "_rpm", "_V", "_A", "_K", "_Pa", "_N", "_m_s2", "_deg"))


def sparkline(points: Sequence[tuple[float, float | None]], from_ms: float, until_ms: float) -> str:
    """Return points as a line of blocks: in each column the point farthest from the middle of the range, × for a gap.

    Args:
        points: times in ms and values, None for a missing one.
        from_ms, until_ms: span of the line.
    """
    numbers = [value for _, value in points if value is not None]
    low, high = min(numbers, default=0.0), max(numbers, default=0.0)
    middle, columns = 0.5 * (low + high), [_EMPTY] * _WIDTH
    farthest = [-1.0] * _WIDTH
    for at_ms, value in points:
        column = int((at_ms - from_ms) / (until_ms - from_ms) * _WIDTH)
        column = max(0, min(column, _WIDTH - 1))
        if value is None:
            columns[column] = _NONE if columns[column] == _EMPTY else columns[column]
        elif abs(value - middle) > farthest[column]:
            farthest[column] = abs(value - middle)
            share = (value - low) / (high - low) if high > low else 0.0
            columns[column] = _BLOCKS[min(int(share * len(_BLOCKS)), len(_BLOCKS) - 1)]
    return "".join(columns)


def _points(series: object) -> list[tuple[float, float | None]]:
    table = _table(series)
    pairs = zip(_list(table.get("t_ms")), _list(table.get("value")), strict=False)
    return [(at, value if _is_number(value) else None) for at, value in pairs if _is_number(at)]


def _table(value: object) -> dict[str, Any]:
    return cast("dict[str, Any]", value) if isinstance(value, dict) else {}


def _list(value: object) -> list[object]:
    return cast("list[object]", value) if isinstance(value, list) else []


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
