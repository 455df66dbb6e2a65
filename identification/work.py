"""Bound on the work of one fit: every record ends in an answer, or in a refusal with what was tried.

Work is counted and not timed, so that a fit gives the same result on every machine and under every load. The unit is
one second of a slow processor core. `identification.least_squares` counts every evaluation of a model; a search with
other expensive steps counts them by `spend`.

    with bounded_work("ring-down", notify):
        tried("start at 1.2 s")
        ...

When the bound is reached, `spend` ends the fit, and `bounded_work` raises OutOfWork. Handlers of failed attempts
(`except IdentificationError`) do not see the end: they would go on to the next attempt.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

from identification.errors import OutOfWork

ELEMENT_S = 1e-7
"""Work of one element (row × column) of an evaluated model and its share of the least squares, s.

Measured 5.3e-8 s for ring-downs of 3 000 to 28 000 rows, with the compiled code loaded, on one core of 2026. A slow
core needs twice the time.
"""

LIMIT_S = 10.0
"""Work of one fit, s: the 15 s of processor that an answer may take, less 5 s for what is not counted.

Not counted are the start of the command, the reading of the log and of the compiled code (2.5 s), and the report.
"""

_QUIET_S = 1.0
"""Work below which attempts are not shown as progress, s: the fit ends before a person has read the line."""


class _LimitReached(Exception):
    """Limit of the work in progress was reached. Not an IdentificationError: no attempt may handle it."""


@dataclass
class _Work:
    what: str
    limit_s: float
    notify: Callable[[str], None]
    spent_s: float = 0.0
    tried: list[str] = field(default_factory=list[str])


_current: ContextVar[_Work | None] = ContextVar("work", default=None)


@contextmanager
def bounded_work(
    what: str, notify: Callable[[str], None] | None = None, limit_s: float = LIMIT_S
) -> Generator[Callable[[], float]]:
    """Bound the work of the enclosed fit. An enclosed bound replaces an outer one.

    Args:
        what: name of the fit, which begins the message.
        notify: called with one line of text for each attempt of a fit that takes long.
        limit_s: work, s of a slow core.
    Yields:
        Function that returns the work so far, s.
    Raises:
        OutOfWork: the work exceeds the limit.
    """
    work = _Work(what, limit_s, notify or (lambda _: None))
    token = _current.set(work)
    try:
        yield lambda: work.spent_s
    except _LimitReached:
        raise OutOfWork(what, limit_s, tuple(work.tried)) from None
    finally:
        _current.reset(token)


def spend(elements: float) -> None:
    """Count work, in elements of an evaluated model (ELEMENT_S). Without an enclosing bound nothing is counted."""
    work = _current.get()
    if work is None:
        return
    work.spent_s += elements * ELEMENT_S
    if work.spent_s > work.limit_s:
        raise _LimitReached


def tried(text: str) -> None:
    """Record an attempt, which is named if the work ends without an answer, and shown if the fit takes long."""
    work = _current.get()
    if work is None:
        return
    work.tried.append(text)
    if work.spent_s > _QUIET_S:
        work.notify(f"{work.what}: {text}")
