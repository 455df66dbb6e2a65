"""The sentence at the end of a guided test: its result from a quick fit, or what was recorded."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from rig_basics.errors import RigError
from rig_basics.texts import number_of
from rig_cli.console import notify
from rig_configs import PARAMETER_SYMBOLS, IdentifiedParameters, with_parameters

if TYPE_CHECKING:
    from daq.guided_tests.runner import TestDone
    from daq.log import Log
    from daq.signals.run import Run
    from rig_configs.schema import Rig

_log = logging.getLogger(__name__)
_PLANNED = 1.25  # ratio to the planned uncertainty up to which a result is as good as planned
_FLICK_RAD_S = 5.0  # slowest flick of the plan
_RING_DOWNS: dict[str, Literal["x", "y"]] = {"ring-down-x": "x", "ring-down-y": "y"}


def result_sentence(done: TestDone) -> str:
    """Return what a test gave. No error of the fit or of the log changes the exit code of a test that is recorded."""
    if done.missed:
        return f"{done.test} did not reach its end: {done.missed}; {_recorded(done)}."
    if done.runs:
        return f"{done.test} done: {number_of(len(done.runs), 'log')}, the last one {_recorded(done)}."
    if "settled" in done.summary:
        is_settled = _is_true(done.summary["settled"])
        why = f" ({done.summary['why']})" if done.summary.get("why") else ""
        found = f": {_quick(done, _point)}" if is_settled else ""
        return f"{done.test} done: {'settled' if is_settled else 'not settled'}{why}{found}; {_recorded(done)}."
    quick = partial(_ring_down, axis=_RING_DOWNS[done.test]) if done.test in _RING_DOWNS else _OTHERS.get(done.test)
    return f"{done.test} done: {'' if quick is None else f'{_quick(done, quick)}; '}{_recorded(done)}."


def _quick(done: TestDone, result: Callable[[Run], str]) -> str:
    """Return the result from the log of this test alone, which is finished: Ctrl-C ends only the evaluation."""
    from daq.signals.run import load_run  # numba takes seconds to import

    try:
        return result(load_run(done.log))
    except KeyboardInterrupt:  # usual: the log is on the disk
        return "no quick result (interrupted, the log is complete)"
    except Exception as error:
        _log.info("%s: quick result: %s", done.log, error, exc_info=not isinstance(error, RigError))
        return f"no quick result ({error})"


def _is_true(fact: Any) -> bool:
    return str(fact).lower() == "true"


def _ring_down(run: Run, axis: Literal["x", "y"]) -> str:
    """Return frequency and damping of the plucked direction, from one sensor, compared with the plan of such a test."""
    from identification import fit_ring_down
    from identification.plan import SensorProperties
    from identification.plan.suspension import ring_down

    time_s, displacement_m = (run.x_time_s, run.x_m) if axis == "x" else (run.y_time_s, run.y_m)
    found = fit_ring_down(time_s, displacement_m, setting="fast", axis=axis)
    mode = "1" if axis == "x" else "2"
    f_Hz, zeta = found.values[f"f{mode}_Hz"], found.values[f"zeta{mode}"]
    place = list(found.values).index(f"zeta{mode}")
    share = math.sqrt(float(found.covariance[place, place])) / zeta
    rig = _rig_of(run)
    first = found.curves[0]
    held_m = float(abs(first.measured).max())
    planned = ring_down(rig.physics, SensorProperties.of(rig), axis, held_m, float(time_s[-1]) - found.release_s[0])
    words = against_plan(share, planned.relative_std(f"zeta{mode}"))
    return f"f{mode} = {f_Hz:.4g} Hz, ζ{mode} = {100 * zeta:.3g} % (± {100 * share:.2g} % of it), {words}"


def against_plan(share: float, planned: float) -> str:
    """Return how a relative standard uncertainty compares with that of the plan of the same record."""
    if share <= _PLANNED * planned:
        return "as good as planned"
    return f"{share / planned:.2g} times as uncertain as planned ({100 * planned:.2g} %)"


def _spin_down(run: Run) -> str:
    """Return the damping of both pendulums, compared with the plan of such a test."""
    from identification.plan import SensorProperties
    from identification.plan.pendulums import spin_down

    rig = _rig_of(run)
    found = _identified(run, rig)
    words = [_with_share(found, name, f"{found.values[name]:.3g} N m s/rad") for name in found.values]
    seconds = float(run.angle_time_s[-1] - run.angle_time_s[0])
    planned = spin_down(rig.physics, SensorProperties.of(rig), _FLICK_RAD_S, seconds)
    compared = [(found.std[name] / abs(found.values[name]), planned.relative_std(name)) for name in found.values]
    share, promised = max(compared, key=lambda pair: pair[0] / pair[1])
    return f"{', '.join(words)}, {against_plan(share, promised)}"


def _passage(run: Run) -> str:
    """Return the resonances and their damping."""
    rig = _rig_of(run)
    found = _identified(run, rig)
    f_Hz = [each / (2 * math.pi) for each in with_parameters(rig, found).physics.natural_frequencies_rad_s]
    words = [f"f{i + 1} = {f_Hz[i]:.4g} Hz" for i in range(2) if f"k{i + 1}_N_per_m" in found.values]
    damped = [name for name in ("zeta1", "zeta2") if name in found.values]
    return ", ".join(words + [_with_share(found, name, f"{100 * found.values[name]:.3g} %") for name in damped])


def _point(run: Run) -> str:
    """Return amplitude and pendulum angles of a settled point, and what compares them with the model."""
    from analysis.steady_state import measure

    found = measure(run, _rig_of(run))
    angles = ", ".join(f"{name} = {math.degrees(a.value):.1f}°" for name, a in zip("AB", found.theta_rad, strict=True))
    value, std = 1e6 * found.amplitude_m.value, 1e6 * found.amplitude_m.std
    return f"amplitude {value:.3g} ± {std:.2g} µm, {angles}; next: rig validate compares it with the model"


def _identified(run: Run, rig: Rig) -> IdentifiedParameters:
    from identification import identify

    return identify([run], rig, notify, setting="fast").parameters


def _with_share(found: IdentifiedParameters, name: str, value: str) -> str:
    return f"{PARAMETER_SYMBOLS[name]} = {value} (± {100 * found.std[name] / abs(found.values[name]):.2g} % of it)"


def _rig_of(run: Run) -> Rig:
    from daq.log.rig_of_logs import RigUse, rig_of_logs

    return rig_of_logs([run.source], RigUse("rig test"))


_OTHERS = {"spin-down": _spin_down, "run-up": _passage, "run-down": _passage}


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
