# pyright: strict
"""What a guided test said of its own end, in the summary of its log: whether it was reached, and what was not.

A test writes `reached` and, where that is false, `ended` with what was not reached. Logs of earlier versions have only
the test's own condition (`rung_down`, `settled` …); those of tests that were broken off have only `ended`. A log that
interlocks ended names them in `tripped`, and every reason in `ended`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.log.opened import Log

REACHED, ENDED, TRIPPED = "reached", "ended", "tripped"
TRIP = "trip"
"""Kind of the event that holds what interlocks found, and the seconds around it."""
_CONDITIONS = {  # the end of each test in logs that do not say `reached`
    "rung_down": "the column did not ring down",
    "slowed_down": "the pendulums did not slow down",
    "reached_top": "the rotor did not reach the top speed",
    "reached_rest": "the rotor did not come to rest",
    "settled": "the steady state was not reached",
}
_GUIDED = ("ring-down", "spin-down", "run-up", "run-down", "point-", "start-ups")


def ending(missed: str) -> dict[str, Any]:
    """The summary's facts about the end of a test.

    Args:
        missed: what was not reached; empty when the test reached its end.
    """
    return {REACHED: not missed, ENDED: f"not reached: {missed}" if missed else "done"}


def tripping(ended: str, reasons: Iterable[tuple[str, str]]) -> dict[str, Any]:
    """The summary's facts about a log that interlocks ended: all that tripped together, by name and with its reason.

    Args:
        ended: what ended the log, as its session says it: the first reason, and what was done.
        reasons: interlock and text of each, the first one first.
    """
    found = list(reasons)
    if not found:
        return {ENDED: ended}
    others = [text for _, text in found if text not in ended]
    return {TRIPPED: ", ".join(dict.fromkeys(name for name, _ in found)), ENDED: "; also ".join([ended, *others])}


def not_reached(test: str, outcome: Mapping[str, Any]) -> str:
    """What a guided test did not reach; empty when it reached its end, or the log tells nothing of one.

    Args:
        test: as the log names it.
        outcome: the summary's values, not their JSON texts.
    """
    said = str(outcome.get(ENDED) or "")
    if REACHED in outcome:  # of any guided test, also one of another package
        return "" if outcome[REACHED] is True else said.removeprefix("not reached: ") or "the test's end"
    if not test.startswith(_GUIDED):
        return ""
    for condition, words in _CONDITIONS.items():
        if outcome.get(condition) is False:
            why = outcome.get("why")
            return f"{words} ({why})" if why else words
    known = any(condition in outcome for condition in _CONDITIONS)
    return f"broken off: {said}" if said and not known else ""


def not_reached_of(log: Log) -> str:
    """What the guided test in a log did not reach; see `not_reached`."""
    outcome = {key: _value(text) for key, text in log.metadata.get("summary", {}).items()}
    return not_reached(log.metadata.get("run", {}).get("test", ""), outcome)


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text
