"""Time per point against true error of the balanced state's largest multiplier, for every method and step number."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Sequence

import numpy as np

from dynamics.bench import heyoka_runs, mpmath_peer
from dynamics.bench.heyoka_runs import Rig
from dynamics.bench.records import ROUNDING, Measurement
from dynamics.bench.timing import median_seconds
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.linearised import PeriodicMatrix, type_one
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import DynamicsError
from dynamics.stability.floquet import METHODS, MonodromyMethod, floquet_multipliers
from dynamics.stability.floquet.multipliers import balanced
from rig_basics.texts import number_of

_log = logging.getLogger(__name__)

SERVICE = "multipliers"
_SCIPY = "single pass"  # the method that uses scipy's integrator counts as a peer
_MAX_USEFUL_ERROR = 0.1
_MIN_STEPS, _MAX_STEPS, _MAX_STEPS_SCIPY = 2, 65536, 64
_FINEST_SCIPY = 3e-14  # tolerance of that method at 64 "steps"


def cases(parameters: RotorParameters, points: dict[str, float], extremes: bool) -> dict[str, Rig]:
    """The points at their speed ratios. With `extremes` a stiff case and a slow case are added."""
    found = {name: (parameters, parameters.speed_rad_s(ratio)) for name, ratio in points.items()}
    if extremes:
        stiff = parameters.with_values(c3_Nms_per_rad=50.0, c4_Nms_per_rad=50.0)
        found["stiff: c34 = 50, Ω = 1.6"] = (stiff, stiff.speed_rad_s(1.6))
        found["slow: Ω = 0.02"] = (parameters, parameters.speed_rad_s(0.02))
    return found


def multiplier_rows(
    case: str, rig: Rig, accuracies: Sequence[float], peer_tolerances: Sequence[float], longest_s: float, repeats: int
) -> list[Measurement]:
    """Rows of every method at its step numbers, of the service at several accuracies, and of heyoka if installed.

    Args:
        accuracies: requested from floquet_multipliers.
        peer_tolerances: heyoka's tolerances per step.
        longest_s: a method's step number is doubled while one call takes less than this time, s.
    """
    matrix = type_one(rig[0], *balanced_angles(rig[0])[0], rig[1])
    runs = heyoka_runs.available()
    if runs:
        true = heyoka_runs.largest_multiplier(rig, heyoka_runs.EXTENDED_TOLERANCE)
    else:
        true = mpmath_peer.largest_multiplier(balanced(matrix))
    rows: list[Measurement] = []
    for method in METHODS.values():
        rows += _method_rows(case, balanced(matrix), method, true, longest_s, repeats)
    for accuracy in accuracies:
        row = _service_row(case, matrix, accuracy, true, repeats)
        rows += [row] if row else []
    for tolerance in peer_tolerances if runs else ():
        rows.append(
            Measurement(
                SERVICE,
                case,
                "heyoka (variational)",
                f"tolerance {tolerance:.1g}",
                median_seconds(lambda tolerance=tolerance: heyoka_runs.largest_multiplier(rig, tolerance), repeats),
                "point",
                _error(heyoka_runs.largest_multiplier(rig, tolerance), true),
                peer=True,
            )
        )
    return rows


def _error(found: float, true: float | None) -> float | None:
    return None if true is None else heyoka_runs.relative(found, true)


def _largest(matrix: PeriodicMatrix, method: MonodromyMethod, steps: int) -> float:
    """Largest modulus over one revolution from one run of a method, without a bound; NaN on overflow."""
    monodromy = method.monodromy(matrix, steps)
    if not np.all(np.isfinite(monodromy)):
        return np.nan
    return float(np.max(np.abs(np.linalg.eigvals(monodromy))) ** (1 if matrix.turn is None else 2))


def _method_rows(
    case: str, matrix: PeriodicMatrix, method: MonodromyMethod, true: float | None, longest_s: float, repeats: int
) -> list[Measurement]:
    peer = method.NAME == _SCIPY
    name = "scipy DOP853 (single pass)" if peer else method.NAME
    rows: list[Measurement] = []
    steps, once = _MIN_STEPS, 0.0
    with np.errstate(all="ignore"):
        _largest(matrix, method, steps)  # compiled
        while steps <= (_MAX_STEPS_SCIPY if peer else _MAX_STEPS) and once < longest_s:
            start = time.perf_counter()
            found = _largest(matrix, method, steps)
            once = time.perf_counter() - start
            error = _error(found, true)
            if np.isfinite(found) and (error is None or error < _MAX_USEFUL_ERROR):
                seconds = median_seconds(lambda steps=steps: _largest(matrix, method, steps), repeats)
                setting = (
                    f"tolerance {max(float(steps) ** -method.ORDER, _FINEST_SCIPY):.0e}"
                    if peer
                    else f"{number_of(steps, 'step')}"
                )
                rows.append(Measurement(SERVICE, case, name, setting, seconds, "point", error, peer=peer))
                if error is not None and _has_ended(rows):
                    break
            steps *= 2
    return rows


def _has_ended(rows: list[Measurement]) -> bool:
    """Whether more steps do not reduce the error: the last three errors do not decrease or are at rounding level."""
    errors = [max(r.true_error or 0.0, ROUNDING) for r in rows]
    return len(errors) > 3 and min(errors[-3:]) > 0.5 * errors[-4]


def _service_row(
    case: str, matrix: PeriodicMatrix, accuracy: float, true: float | None, repeats: int
) -> Measurement | None:
    try:
        found = floquet_multipliers(matrix, accuracy)
    except DynamicsError as error:
        _log.info("multipliers, accuracy %.0e: left out of the table: %s", accuracy, error)
        return None
    # a new matrix each time, so that results cached by the last call are not used
    seconds = median_seconds(lambda: floquet_multipliers(dataclasses.replace(matrix), accuracy), repeats)
    return Measurement(
        SERVICE,
        case,
        f"automatic: {found.method}",
        f"accuracy {accuracy:.0e}",
        seconds,
        "point",
        _error(found.largest, true),
        found.error_estimate / max(1.0, found.largest),
        automatic=True,
        accuracy=accuracy,
        chosen=(found.method,),
    )
