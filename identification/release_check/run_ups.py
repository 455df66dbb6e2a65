"""Comparison of a further run-up with the identified parameters, as rows for a validation.

Steady states at points hardly depend on the suspension's damping. One further run-up determines it as well as ten
start-ups of each point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from daq.signals.run import Run
from identification.errors import IdentificationError
from identification.estimate import Estimate
from identification.methods import runs_for
from identification.mounting import as_mounted
from identification.physical import keep_physical, run_up_sides
from identification.release_check.check import ReleaseRows, used_for
from identification.run_up.fit import fit_run_up_run, run_up_estimate
from identification.suspension_terms import known_suspension
from rig_basics.arrays import Array
from rig_configs import IdentifiedParameters, Rig


def check_run_ups(
    runs: Sequence[Run], rig: Rig, identified: IdentifiedParameters, progress: Callable[[str], None] | None = None
) -> list[ReleaseRows]:
    """Compare every run-up or run-down that was not used for the identification with the identified parameters.

    Args:
        runs: recorded tests; other tests are ignored.
        rig: known numbers, gains and mounting, with their uncertainties.
        identified: parameters with covariance.
        progress: called with one line of text before each run-up.
    Returns:
        One result per run-up, named by its test. If a run-up cannot be evaluated, its result has no rows, and
        `sentence` contains the reason.
    Source: docs/theory/validation.md.
    """
    found, taken = list[ReleaseRows](), dict[str, int]()
    for run in sorted(runs_for("passage", runs), key=lambda run: run.start_s):
        if used_for(run, identified):
            continue
        taken[run.test] = taken.get(run.test, 0) + 1
        name = f"{run.test} ({taken[run.test]})" if taken[run.test] > 1 else run.test
        if progress is not None:
            progress(f"{run.test}: comparing it with the identified parameters")
        try:
            found.append(_rows(name, _estimate(run, rig, identified), rig, identified))
        except IdentificationError as error:
            names = tuple(identified.values)
            none = np.empty((0, len(names)))
            found.append(ReleaseRows(name, (), np.empty(0), np.empty((0, 0)), none, names, sentence=f"{error}"))
    return found


def _estimate(run: Run, rig: Rig, identified: IdentifiedParameters) -> Estimate:
    """Return the estimate of a run-up, as an identification uses it."""
    physics, angle = identified.applied_to(rig.physics), identified.axis_angle_deg
    known = None
    if identified.terms is not None:
        known = known_suspension(physics, identified.terms, (angle[0] if angle else run.turn_deg) - run.turn_deg)
    fit = as_mounted(fit_run_up_run(run, known=known), run.turn_deg)
    gains = rig.roles.gain_stds
    estimate, _ = run_up_sides(run, fit, run_up_estimate(run, fit, rig.physics, gains), rig, gains)
    physical, warnings = keep_physical(estimate, rig)
    if physical is None:
        raise IdentificationError("; ".join(warnings))
    return physical.with_sources(rig.known.sources)


def _rows(name: str, found: Estimate, rig: Rig, identified: IdentifiedParameters) -> ReleaseRows:
    values, places = identified.values, [i for i, n in enumerate(found.names) if n in identified.values]
    names = [found.names[i] for i in places]
    by = np.array([[-float(n == parameter) for parameter in values] for n in names]).reshape(len(names), len(values))
    own: Array = found.covariance[np.ix_(places, places)]
    taken = identified.shared_with(rig.known)
    shared = {label: by @ shift for label, shift in taken.items()}
    for label, shift in found.shared.items():
        part = shift[places]
        if label.kind == "clock":  # a clock's line is fitted separately in every log
            own = own + np.outer(part, part)
        else:
            shared[label] = shared.get(label, np.zeros(len(names))) + part
    by_number = {number: slope[places] for number, slope in found.by_number.items()}
    off = np.array([found.value(n) - values[n] for n in names])
    sentence = f"compared by {', '.join(names)}" if names else "not compared: it shows no identified parameter"
    return ReleaseRows(name, tuple(names), off, own, by, tuple(values), by_number, shared, sentence=sentence)
