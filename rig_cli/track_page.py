"""Results of `rig track`: final dampings, whether they are trusted, readings, losses; terminal and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from daq.guided_test_kinds import kind_of
from daq.signals.run import Run
from identification import NotIdentifiable
from identification.tracking.replay import TrackedRun
from identification.tracking.tracker import STATE_NAMES
from rig_basics.texts import number_of
from rig_cli.console import show
from rig_configs import PARAMETER_UNITS, IdentifiedParameters, Rig

_NAMES = {"c3": "c3_Nms_per_rad", "c4": "c4_Nms_per_rad"}
_COVERAGE_FACTOR = 1.96  # standard deviations of a 95 % interval
_MAX_NARROWED = 0.5  # ratio of final to initial relative standard deviation above which a damping is not learned


@dataclass(frozen=True)
class KnownDamping:
    """A damping for comparison with the tracked one: value, standard deviation and 95 % interval, N m s/rad."""

    value: float
    std: float

    @property
    def low(self) -> float:
        """Lower end of the 95 % interval."""
        return max(self.value - _COVERAGE_FACTOR * self.std, 1e-3 * abs(self.value))

    @property
    def high(self) -> float:
        """Upper end of the 95 % interval."""
        return self.value + _COVERAGE_FACTOR * self.std


@dataclass(frozen=True)
class Tracking:
    """Result of tracking one log.

    Attributes:
        run, rig: the recorded run, and the rig whose parameters were used.
        found: the steps.
        setting: "fast" or "reference".
        against: parameters file for comparison of the dampings; None without one.
        against_path: its path.
        run_warnings: warnings about the run itself.
        files: files written.
    """

    run: Run
    rig: Rig
    found: TrackedRun
    setting: Literal["fast", "reference"]
    against: IdentifiedParameters | None
    against_path: Path | None
    run_warnings: tuple[str, ...] = ()
    files: tuple[Path, ...] = field(default=())

    def with_files(self, files: list[Path]) -> Tracking:
        """Return a copy with the written files."""
        return replace(self, files=tuple(files))

    @property
    def known(self) -> dict[str, KnownDamping]:
        """Dampings of the parameters file by their short names, or the rig file's with an unknown uncertainty (0)."""
        physics = self.rig.physics
        own = (physics.a.damping_Nms_per_rad, physics.b.damping_Nms_per_rad)
        if self.against is None:
            return {short: KnownDamping(value, 0.0) for short, value in zip(_NAMES, own, strict=True)}
        values, std = self.against.values, self.against.std
        return {short: KnownDamping(values[name], std[name]) for short, name in _NAMES.items() if name in values}

    @property
    def known_text(self) -> str:
        """Source of the dampings for comparison."""
        return "rig file" if self.against_path is None else f"{self.against_path.name}, 95 %"

    @property
    def learned(self) -> dict[str, bool]:
        """Whether each damping's relative interval is clearly narrower than at the start."""
        relative = self.found.std / self.found.values
        return {short: bool(relative[-1, j] < _MAX_NARROWED * relative[0, j]) for j, short in enumerate(_NAMES)}

    @property
    def trusted(self) -> bool:
        """Whether the filter follows the readings at the end and has learned both dampings."""
        return self.found.last.trusted and all(self.learned.values())

    @property
    def warnings(self) -> list[str]:
        """Warnings about the numbers."""
        found, warnings = self.found, list(self.run_warnings)
        if not found.trusted.any():
            warnings.append(
                f"{self.run.source}: the filter never followed the readings; the numbers of the rig file and of "
                "--parameters may not be those of the rig that was recorded"
            )
        elif not found.last.trusted:
            warnings.append(f"{self.run.source}: at the end the filter does not follow the readings")
        for short, learned in self.learned.items():
            if not learned:
                warnings.append(
                    f"{self.run.source}: this run contains almost no information on {short}: its start value remains"
                )
        if found.smoothed is not None and found.smoothed.kept > 0:
            warnings.append(
                f"{self.run.source}: at {100 * found.smoothed.kept:.2g} % of the steps the smoother is less certain "
                "than the filter; the filter's estimate stands there"
            )
        return warnings


def trackable(run: Run) -> tuple[str, ...]:
    """Return warnings about a run that may be tracked.

    Raises:
        NotIdentifiable: it has no angles, no marks while the rotor turns, or its pendulums are locked.
    """
    angles = run.angle_rad.size and np.isfinite(run.angle_rad).any(axis=0).all()
    if not angles:
        raise NotIdentifiable(
            f"{run.source}: expected angles of both pendulums, the log has "
            f"{number_of(len(run.angle_time_s), 'reading')} with "
            "angles; record with encoders, or use a log of a spin-down or of a point"
        )
    kind, marks = kind_of(run.test), len(run.mark_time_s)
    if kind is not None and kind.gives and not set(_NAMES.values()) & set(kind.gives):
        raise NotIdentifiable(
            f"{run.source}: expected a test in which the pendulums swing, a {run.test} keeps them locked; use a log of "
            "a spin-down or of a point"
        )
    if kind is not None and kind.turns and marks < 2:
        raise NotIdentifiable(
            f"{run.source}: expected index marks, because the rotor turns in a {run.test}; the log has {marks}. "
            "Without them the imbalance's direction is not known: record with the tachometer"
        )
    if marks >= 2 and not run.phase_absolute:
        raise NotIdentifiable(
            f"{run.source}: expected a rotor phase that is zero where the imbalance points along +x, this recording "
            "has an integrated speed; import it again with marks or a phase"
        )
    if kind is None and marks < 2:
        return (f"{run.source}: no index marks; the rotor is assumed to be at rest",)
    return ()


def tracking_json(result: Tracking) -> dict[str, Any]:
    """Return the JSON of one log."""
    found, last = result.found, result.found.last
    against = result.known if result.against is not None else {}
    return {
        "log": result.run.source,
        "test": result.run.test,
        "rig": result.rig.name,
        "setting": result.setting,
        "rows": len(found.time_s),
        "from_s": float(found.time_s[0]),
        "to_s": float(found.time_s[-1]),
        "trusted": result.trusted,
        "parameters": {
            name: {
                "value": float(found.values[-1, j]),
                "std": float(found.std[-1, j]),
                "interval95": [float(found.low[-1, j]), float(found.high[-1, j])],
                "start": float(found.values[0, j]),
                "learned": result.learned[short],
                "unit": PARAMETER_UNITS[name],
                "known": _against(against[short], found, j) if short in against else None,
            }
            for j, (short, name) in enumerate(_NAMES.items())
        },
        "states": {
            name: {"value": float(found.states[-1, j]), "std": float(found.state_std[-1, j])}
            for j, name in enumerate(STATE_NAMES)
        },
        "readings": dict(last.counts),
        "lost": dict(result.run.losses),
        "smoother": None
        if found.smoothed is None
        else {"stretches": found.smoothed.stretches, "filter_kept_share": found.smoothed.kept},
        "parameters_file": None if result.against_path is None else str(result.against_path),
        "warnings": result.warnings,
        "files": [str(file) for file in result.files],
    }


def _against(known: KnownDamping, found: TrackedRun, j: int) -> dict[str, float]:
    """Return a known damping and the deviation of the tracked one in standard deviations of both together."""
    both = math.hypot(known.std, float(found.std[-1, j]))
    return {"value": known.value, "std": known.std, "z": (float(found.values[-1, j]) - known.value) / both}


def print_tracking(result: Tracking) -> None:
    """Print the summary of one log."""
    facts, found = tracking_json(result), result.found
    show(
        f"{result.run.source}: {result.run.test}, {facts['to_s'] - facts['from_s']:.1f} s, "
        f"{number_of(facts['rows'], 'row')}, "
        f"{result.setting} setting"
    )
    for j, (short, name) in enumerate(_NAMES.items()):
        value, (low, high) = facts["parameters"][name]["value"], facts["parameters"][name]["interval95"]
        line = f"{short} {value:.4g} N m s/rad, 95 % {low:.4g} to {high:.4g}"
        known = facts["parameters"][name]["known"]
        if known is not None:
            line += f"; {result.known_text.removesuffix(', 95 %')} {known['value']:.4g} ± {known['std']:.1g}, "
            line += f"z {known['z']:+.1f}"
        show(line)
        if found.smoothed is not None:
            s = found.smoothed
            show(
                f"   over the run, smoothed: {s.values[:, j].min():.4g} to {s.values[:, j].max():.4g}, at the start "
                f"{s.values[0, j]:.4g}, 95 % {s.low[0, j]:.4g} to {s.high[0, j]:.4g}"
            )
    counts = facts["readings"]
    taken = counts["used"] + counts["refused"] + counts["late"]
    show(
        f"readings: {taken}, used {counts['used']}, rejected {counts['refused']}, too late {counts['late']}; "
        f"new starts {counts['restarts']}, repairs of the covariance {counts['repairs']}"
    )
    lost = {name: count for name, count in result.run.losses.items() if count}
    show(f"lost on the way to the log: {', '.join(f'{name} {count}' for name, count in lost.items()) or 'nothing'}")
    show(_verdict(result))


def _verdict(result: Tracking) -> str:
    """Return whether to trust the numbers, and how to use them."""
    if result.trusted:
        return (
            "trusted: the filter follows the readings and both dampings are learned from them. Intervals of a "
            "filter are a guide; quote those of `rig identify`"
        )
    if not result.found.last.trusted:
        return "not trusted: the filter does not follow the readings"
    slow: Mapping[str, bool] = result.learned
    return f"not trusted: this run does not show {' and '.join(n for n, learned in slow.items() if not learned)}"
