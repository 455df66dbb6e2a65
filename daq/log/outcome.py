"""Result that a guided test wrote into the summary of its log: whether it reached its end, and what was not reached.

A test writes `reached` and, if that is false, `ended` with what was not reached. Logs of aborted tests have only
`ended`. A log that was ended by interlocks lists them in `tripped`, and every reason in `ended`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.log.opened import Log

REACHED, ENDED, TRIPPED = "reached", "ended", "tripped"
TRIP = "trip"
"""Kind of the event that contains an interlock's finding and the data of the seconds before and after it."""
_GUIDED = ("ring-down", "spin-down", "run-up", "run-down", "point-", "start-ups")


def ending(missed: str) -> dict[str, Any]:
    """Return the summary's facts about the end of a test.

    Args:
        missed: what was not reached; empty if the test reached its end.
    """
    return {REACHED: not missed, ENDED: f"not reached: {missed}" if missed else "done"}


def tripping(ended: str, reasons: Iterable[tuple[str, str]]) -> dict[str, Any]:
    """Return the summary's facts about a log that interlocks ended: all simultaneous trips, each with its reason.

    Args:
        ended: the session's text on the end of the log: the first reason, and the reaction.
        reasons: interlock and text of each trip, the first one first.
    """
    found = list(reasons)
    if not found:
        return {ENDED: ended}
    others = [text for _, text in found if text not in ended]
    return {TRIPPED: ", ".join(dict.fromkeys(name for name, _ in found)), ENDED: "; also ".join([ended, *others])}


def not_reached(test: str, outcome: Mapping[str, Any]) -> str:
    """Return what a guided test did not reach; empty if it reached its end, or the log has no such facts.

    Args:
        test: name of the test in the log.
        outcome: values of the summary, decoded from JSON.
    """
    ended = str(outcome.get(ENDED) or "")
    if REACHED in outcome:  # written by any guided test, also by tests of other packages
        return "" if outcome[REACHED] is True else ended.removeprefix("not reached: ") or "the test's end"
    return f"broken off: {ended}" if ended and test.startswith(_GUIDED) else ""


def not_reached_of(log: Log) -> str:
    """Return what the guided test in a log did not reach; see `not_reached`."""
    return not_reached(log.metadata.get("run", {}).get("test", ""), summary_of(log))


def summary_of(log: Log) -> dict[str, Any]:
    """Return the values of a log's summary, decoded from JSON; a text that is no JSON is returned unchanged."""
    return {key: json_or_text(text) for key, text in log.metadata.get("summary", {}).items()}


def json_or_text(text: str) -> Any:
    """Return a value decoded from JSON; a text that is no JSON is returned unchanged."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):  # usual: plain text
        return text
