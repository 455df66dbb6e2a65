"""The sentence at the end of a guided test: its result from a quick fit, or what was recorded."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, Literal

from rig_basics.errors import RigError
from rig_basics.texts import number_of

if TYPE_CHECKING:
    from daq.guided_tests.runner import TestDone
    from daq.log import Log

_log = logging.getLogger(__name__)
_RING_DOWNS: dict[str, Literal["x", "y"]] = {"ring-down-x": "x", "ring-down-y": "y"}


def result_sentence(done: TestDone) -> str:
    """Return what a test gave. No error of the fit or of the log changes the exit code of a test that is recorded."""
    if done.missed:
        return f"{done.test} did not reach its end: {done.missed}; {_recorded(done)}."
    if done.runs:
        return f"{done.test} done: {number_of(len(done.runs), 'log')}, the last one {_recorded(done)}."
    if (axis := _RING_DOWNS.get(done.test)) is not None:
        return f"{done.test} done: {_ring_down(done, axis)}; {_recorded(done)}."
    if "settled" in done.summary:
        settled = "settled" if _is_true(done.summary["settled"]) else "not settled"
        why = f" ({done.summary['why']})" if done.summary.get("why") else ""
        return f"{done.test} done: {settled}{why}; {_recorded(done)}."
    return f"{done.test} done: {_recorded(done)}."


def _is_true(fact: Any) -> bool:
    return str(fact).lower() == "true"


def _ring_down(done: TestDone, axis: Literal["x", "y"]) -> str:
    """Return frequency and damping of the plucked direction, from one sensor."""
    from daq.signals.run import load_run
    from identification import fit_ring_down  # scipy and numba take seconds to import

    try:
        run = load_run(done.log)
        time_s, displacement_m = (run.x_time_s, run.x_m) if axis == "x" else (run.y_time_s, run.y_m)
        found = fit_ring_down(time_s, displacement_m, setting="fast", axis=axis)
        mode = "1" if axis == "x" else "2"
        f_Hz, zeta = found.values[f"f{mode}_Hz"], found.values[f"zeta{mode}"]
    except Exception as error:
        _log.info("%s: quick fit: %s", done.log, error, exc_info=not isinstance(error, RigError))
        return f"no quick result ({error})"
    return f"f{mode} = {f_Hz:.4g} Hz, ζ{mode} = {100 * zeta:.3g} %"


def _recorded(done: TestDone) -> str:
    """Return duration, samples and losses of a log."""
    from daq.log import open_log
    from daq.log.losses import losses_of

    try:
        with open_log(done.log) as log:
            lost = losses_of(log).words()
            seconds, samples = 1e-9 * (log.end_ns - log.start_ns), _samples(log)
    except RigError as error:
        return f"its log cannot be read ({error})"
    counted = f"{seconds:.1f} s with {number_of(samples, 'sample')} recorded"
    return f"{counted}, {lost}" if lost == "nothing lost" else f"{counted}, lost: {lost}"


def _samples(log: Log) -> int:
    """Return the number of samples of all sensors."""
    return sum(log.count(topic) for topic in log.topics if not topic.startswith(("raw/", "events", "health")))
