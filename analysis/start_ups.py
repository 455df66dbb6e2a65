"""Repeated start-ups against the model: their final states, their scatter and the remaining vibration.

The model reaches the same steady state (or its mirror image) from all initial states. Final angles therefore differ by
the errors of the measurements only. A larger scatter is due to friction, play or a varying speed.
Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import gammaincc

from analysis.prediction import QUANTITIES
from analysis.results import PointResult
from analysis.scores import DISPLAYED, NAMES, finite
from rig_basics.arrays import Array
from rig_basics.texts import number_of

START_UPS = "start-ups"
"""Name of the guided test."""
SCATTER_LEVEL = 0.005
"""Share of series whose scatter is falsely reported to exceed the errors of the measurements."""
_SHOWN = ("theta3", "theta4", "amplitude_x", "amplitude_y")
_SAME_STATE_RAD = 0.02  # largest difference between predictions of the same state
_MIN_AMPLITUDE_STDS = 5.0  # amplitude over standard deviation of noise above which its error is normal


@dataclass(frozen=True)
class Scatter:
    """Scatter of one quantity at the end of start-ups; rad or m.

    Attributes:
        mean: mean of measured minus predicted.
        found: standard deviation between start-ups.
        explained: scatter due to the measurements (root mean square of their standard deviations).
        p: probability that the errors of the measurements alone scatter as much.
    """

    mean: float
    found: float
    explained: float
    p: float


@dataclass(frozen=True)
class Ending:
    """Start-ups that ended at the same state of the model.

    Attributes:
        state: "I", "II" or "III".
        theta_deg: θ3, θ4 of the model in this state, shape (2,).
        count: number of start-ups.
        scatter: scatter by quantity, if two or more start-ups ended here.
        vibration_m: remaining rms radius of each start-up; predicted_m: that of the model.
        noise_m: rms radius of noise alone.
        locked_m: rms radius of order 1 with locked pendulums at the same speed just before the release; NaN if the
            log does not contain it.
    """

    state: str
    theta_deg: Array
    count: int
    scatter: Mapping[str, Scatter]
    vibration_m: Array
    predicted_m: float
    noise_m: float
    locked_m: float

    @property
    def left(self) -> float:
        """Mean share of the locked rotor's vibration that remains."""
        return float(np.mean(self.vibration_m)) / self.locked_m

    @property
    def scattering(self) -> tuple[str, ...]:
        """Quantities that scatter more than the measurements explain."""
        level = SCATTER_LEVEL / max(1, len(self.scatter))
        return tuple(name for name, one in self.scatter.items() if one.p < level)

    def to_json(self) -> dict[str, Any]:
        """Return plain values in degrees and millimetres."""
        shown: dict[str, Any] = {}
        for name, one in self.scatter.items():
            _, factor, unit = DISPLAYED[name]
            shown[name] = {
                f"mean_difference_{unit}": one.mean * factor,
                f"scatter_{unit}": one.found * factor,
                f"explained_{unit}": one.explained * factor,
                "p": one.p,
            }
        return {
            "state": self.state,
            "predicted_theta_deg": self.theta_deg.tolist(),
            "count": self.count,
            "scatter": shown,
            "vibration_um": {
                "mean": 1e6 * float(np.mean(self.vibration_m)),
                "largest": 1e6 * float(np.max(self.vibration_m)),
                "predicted": 1e6 * self.predicted_m,
                "noise": 1e6 * self.noise_m,
                "locked": finite(1e6 * self.locked_m),
            },
        }


@dataclass(frozen=True)
class StartUps:
    """A series of start-ups at one speed.

    Attributes:
        speed_rpm: requested speed; 0 if no log contains it.
        results: comparison of each start-up with the model.
        endings: final states of the model that were reached, the most frequent first.
    """

    speed_rpm: float
    results: Sequence[PointResult]
    endings: Sequence[Ending]

    @property
    def counts(self) -> dict[str, int]:
        """Number of start-ups with each verdict."""
        return dict(Counter(each.verdict for each in self.results).most_common())

    @property
    def passed(self) -> bool:
        """Whether each start-up agrees with the model and no final state scatters too much."""
        return all(each.verdict == "pass" for each in self.results) and not any(e.scattering for e in self.endings)

    @property
    def sentences(self) -> list[str]:
        """Result of the series in sentences, the verdict first."""
        counted = ", ".join(f"{number} {verdict}" for verdict, number in self.counts.items())
        at = f"{self.speed_rpm:.4g} rpm" if self.speed_rpm else "a speed that no log states"
        first = f"{number_of(len(self.results), 'start-up')} at {at}: {'pass' if self.passed else 'FAIL'}"
        found = [f"{first} ({counted})"]
        for ending in self.endings:
            found.append(f"{ending.count} ended at {_place(ending)}: {'; '.join(_scattered(ending))}")
            found.append(_vibration(ending))
        return found + [f"{each.source}: {each.why}" for each in self.results if each.verdict != "pass"]

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "speed_rpm": self.speed_rpm,
            "passed": self.passed,
            "counts": self.counts,
            "sentences": self.sentences,
            "endings": [ending.to_json() for ending in self.endings],
            "logs": [{"log": e.source, **e.to_json()} for e in self.results],
        }


def start_ups(speed_rpm: float, results: Sequence[PointResult], locked_m: Sequence[float]) -> StartUps:
    """Return the result of a series from the comparison of each start-up.

    Args:
        speed_rpm: requested speed.
        results: one comparison per log.
        locked_m: rms radius of order 1 of each with locked pendulums just before the release; NaN if not recorded.
    """
    groups: list[list[int]] = []
    for i, each in enumerate(results):
        if each.prediction is None or each.measurement is None or each.state != each.prediction.state.type:
            continue
        for group in groups:
            if _alike(each, results[group[0]]):
                group.append(i)
                break
        else:
            groups.append([i])
    groups.sort(key=lambda group: -len(group))
    endings = [_ending([results[i] for i in group], [locked_m[i] for i in group]) for group in groups]
    return StartUps(speed_rpm, tuple(results), endings)


def _alike(one: PointResult, two: PointResult) -> bool:
    """Whether the model predicts the same state for both; mirror images are different states."""
    assert one.prediction is not None
    assert two.prediction is not None
    apart = np.exp(1j * one.prediction.values[:2]) - np.exp(1j * two.prediction.values[:2])
    return one.state == two.state and bool(np.all(np.abs(apart) < _SAME_STATE_RAD))


def _ending(group: Sequence[PointResult], locked_m: Sequence[float]) -> Ending:
    differences, own = list[Array](), list[Array]()
    radius, predicted, noise = list[float](), list[float](), list[float]()
    for each in group:
        measured, prediction = each.measurement, each.prediction
        assert measured is not None
        assert prediction is not None
        stated = [*measured.theta_rad, measured.amplitude_x_m, measured.amplitude_y_m, measured.amplitude_m]
        off = np.array([one.value for one in stated]) - prediction.values
        off[:2] = np.angle(np.exp(1j * off[:2]))
        differences.append(off)
        own.append(np.diag(measured.own + prediction.own))
        radius.append(measured.amplitude_m.value)
        predicted.append(float(prediction.values[4]))
        noise.append(measured.noise_floor_m)
    prediction = group[0].prediction
    assert prediction is not None
    size = np.abs(prediction.values)
    shown = [name for name in _SHOWN if DISPLAYED[name].is_angle or _moves(name, size, own)]
    scatter: dict[str, Scatter] = {}
    if len(group) > 1:
        table, variance = np.array(differences), np.array(own)
        scatter = {n: _scatter(table[:, QUANTITIES.index(n)], variance[:, QUANTITIES.index(n)]) for n in shown}
    known = [value for value in locked_m if math.isfinite(value)]
    return Ending(
        group[0].state,
        np.degrees(prediction.values[:2]) % 360,
        len(group),
        scatter,
        np.array(radius),
        float(np.mean(predicted)),
        float(np.mean(noise)),
        float(np.mean(known)) if known else math.nan,
    )


def _moves(name: str, size: Array, own: Sequence[Array]) -> bool:
    """Whether an amplitude is clearly above noise, so that its error is normal."""
    at = QUANTITIES.index(name)
    return bool(size[at] > _MIN_AMPLITUDE_STDS * math.sqrt(max(float(each[at]) for each in own)))


def _scatter(values: Array, variance: Array) -> Scatter:
    weight = 1 / variance
    mean = float(weight @ values / weight.sum())
    chi2 = float(weight @ (values - mean) ** 2)
    p = float(gammaincc(0.5 * (len(values) - 1), 0.5 * chi2))
    return Scatter(mean, float(np.std(values, ddof=1)), math.sqrt(float(np.mean(variance))), p)


def _place(ending: Ending) -> str:
    a, b = ending.theta_deg
    return f"state {ending.state} (θ3 {a:.1f}°, θ4 {b:.1f}°)"


def _scattered(ending: Ending) -> list[str]:
    sentences: list[str] = []
    for name, one in ending.scatter.items():
        display = DISPLAYED[name]
        factor, number, unit = display.factor, *((1.0, "°") if display.is_angle else (1e3, " µm"))
        text = f"{NAMES[name]} {number * factor * one.mean:+.2g}{unit} from the model, scatter "
        text += f"{number * factor * one.found:.2g}{unit}, explained {number * factor * one.explained:.2g}{unit}"
        if name in ending.scattering:
            text += f", p = {one.p:.1g}: friction, play or a speed that wanders"
        sentences.append(text)
    return sentences or ["one start-up has no scatter"]


def _vibration(ending: Ending) -> str:
    mean, largest = (_length(float(of(ending.vibration_m))) for of in (np.mean, np.max))
    text = (
        f"vibration left: {mean} rms radius, largest {largest}; the model has {_length(ending.predicted_m)}, noise "
        f"alone {_length(ending.noise_m)}"
    )
    if math.isfinite(ending.locked_m) and ending.locked_m > 0:
        share = 100 * ending.left
        text += (
            f"; {f'{share:.0f}' if share > 10 else f'{share:.2g}'} % of the locked rotor's {_length(ending.locked_m)}"
        )
    return text


def _length(metres: float) -> str:
    """Format three digits in µm or mm; lengths below 1 nm are 0."""
    return f"{1e3 * metres:.3g} mm" if metres >= 1e-3 else f"{1e6 * metres if metres > 1e-9 else 0:.3g} µm"
