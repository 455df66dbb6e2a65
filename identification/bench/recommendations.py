"""Recommended setting of an estimator, derived from the rows of one run.

Two settings of a case have rms errors over n and m records, whose logarithms have standard deviations of about 1/√(2n)
and 1/√(2m). A setting counts as more exact if its error, in a case or in the mean over the cases, is smaller by more
than twice both together, over at least LEAST records per case, or if it has fewer gross failures by as much. It counts
as equally exact if the mean gain and twice that standard deviation together are below a factor NO_GAIN. Otherwise the
rows do not decide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Literal

from dynamics.bench.recommendations import Recommendation, log_ratio
from dynamics.bench.wording import times
from identification.bench.trials import SETTINGS, Precision
from rig_basics.texts import number_of

NO_GAIN = 1.5
"""Factor of the error that justifies a slower setting."""
LEAST = 10
"""Smallest number of records for a significant difference of errors."""
_USUAL = "balanced"

Verdict = Literal["better", "same", "undecided"]


@dataclass(frozen=True)
class _Pair:
    """Comparison of a slower setting with a faster one over all cases of a service.

    Attributes:
        verdict: whether the slower setting is "better" in some case, the "same", or "undecided".
        gain: error of the faster setting over that of the slower one, smallest and largest of the cases.
        fewer_failures: number of gross failures that the slower setting avoids.
        at_most: upper bound of the mean gain over the cases, scatter included.
        records: smallest number of records in any case.
    """

    verdict: Verdict
    gain: tuple[float, float]
    fewer_failures: int
    at_most: float
    records: int


def recommended_settings(rows: Sequence[Precision]) -> list[Recommendation]:
    """Return one recommendation for each service whose estimator was measured at more than one setting."""
    found: list[Recommendation] = []
    for service in dict.fromkeys(row.service for row in rows):
        own = {s: {r.case: r for r in rows if r.service == service and not r.peer and r.setting == s} for s in SETTINGS}
        own = {s: by_case for s, by_case in own.items() if by_case}
        if len(own) > 1:
            found.append(_of_service(service, own))
    return found


def _of_service(service: str, own: dict[str, dict[str, Precision]]) -> Recommendation:
    cases = [case for case in next(iter(own.values())) if all(case in by_case for by_case in own.values())]
    usual = _USUAL if _USUAL in own else next(iter(own))
    figures = {s: _figures(own[s], own[usual], cases) for s in own}
    by_time = sorted(own, key=lambda s: figures[s]["time"])
    chosen, reasons, doubts = by_time[0], list[str](), list[str]()
    for slower in by_time[1:]:
        pair = _compare(own[chosen], own[slower], cases)
        cost = f"{slower} takes {times(figures[slower]['time'] / figures[chosen]['time'])} the time of {chosen}"
        if pair.verdict == "better":
            reasons.append(f"{cost} and {_gained(pair)}")
            chosen = slower
        elif pair.verdict == "same":
            measured = f"{number_of(len(cases), 'case')} of {number_of(pair.records, 'record')} or more"
            reasons.append(f"{cost} and is at most {times(pair.at_most)} as exact ({measured})")
        else:
            doubts.append(
                f"{cost}, its errors, {_span(pair)} those of {chosen}, may be chance with "
                f"{number_of(pair.records, 'record')} a case"
            )
    reasoning = "; ".join(reasons + doubts)
    if doubts:
        advice = f"no recommendation, more records decide (a quick run takes few), {usual} is usual"
        return Recommendation(service, None, f"{service}: {advice}; {reasoning}", figures)
    return Recommendation(service, chosen, f"{service}: take {chosen}; {reasoning}", figures)


def _span(pair: _Pair) -> str:
    low, high = 1 / pair.gain[1], 1 / pair.gain[0]
    return times(low) if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {times(high)}"


def _gained(pair: _Pair) -> str:
    if pair.fewer_failures:
        return f"fails {number_of(pair.fewer_failures, 'record')} fewer"
    return f"has errors up to {times(pair.gain[1])} smaller"


def _figures(own: dict[str, Precision], usual: dict[str, Precision], cases: Sequence[str]) -> dict[str, Any]:
    """Return time and errors over those of the usual setting."""
    errors = [math.exp(log_ratio(_error(own[c]), _error(usual[c]))) for c in cases]
    return {
        "time": median(own[c].seconds / usual[c].seconds for c in cases),
        "error": (min(errors), max(errors)),
        "records": min(own[c].runs for c in cases),
    }


def _error(row: Precision) -> float:
    """Return the largest rms error over bound, without gross failures."""
    return max(row.rms.values()) if row.rms else math.inf


def _compare(faster: dict[str, Precision], slower: dict[str, Precision], cases: Sequence[str]) -> _Pair:
    gains: list[float] = []
    scatters: list[float] = []
    fewer, better = 0, False
    sufficient = all(min(r.runs - r.gross for r in (faster[c], slower[c])) >= LEAST for c in cases)
    for case in cases:
        a, b = faster[case], slower[case]
        gains.append(log_ratio(_error(a), _error(b)))
        scatters.append(2 * math.sqrt(0.5 / max(1, a.runs - a.gross) + 0.5 / max(1, b.runs - b.gross)))
        failures = max(0, _failures(a, b))
        fewer += failures
        better = better or failures > 0 or (sufficient and gains[-1] > scatters[-1])
    mean, scatter = sum(gains) / len(cases), math.sqrt(sum(one**2 for one in scatters)) / len(cases)
    better = better or (sufficient and mean > scatter)
    verdict: Verdict = "better" if better else "same" if mean + scatter <= math.log(NO_GAIN) else "undecided"
    least = min(min(faster[c].runs, slower[c].runs) for c in cases)
    return _Pair(verdict, (math.exp(min(gains)), math.exp(max(gains))), fewer, math.exp(mean + scatter), least)


def _failures(a: Precision, b: Precision) -> int:
    """Return the number of failures of a in excess of those of b for as many records; 0 if it may be chance."""
    share = b.gross / b.runs
    more = a.gross - share * a.runs
    spread = math.sqrt(a.runs * (a.gross + b.gross + 1) / (a.runs + b.runs) * (1 + a.runs / b.runs))
    return round(more) if more > 2 * spread else 0
