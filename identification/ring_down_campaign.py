"""Fit of all ring-downs of a campaign: separately if each resolves both directions, otherwise in one joint fit."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from daq.signals.run import Run
from identification.clocks import joined_rates
from identification.errors import IdentificationError
from identification.estimate import Estimate
from identification.mounting import as_mounted
from identification.ring_down.fit import fit_ring_down_runs, ring_down_estimate
from identification.ring_down.one_laser import fit_one_laser, living_lasers
from identification.ring_down.result import RingDownFit
from identification.setting import Setting
from identification.sources import Sources
from rig_configs.roles import AXIS_TOLERANCE_DEG


@dataclass(frozen=True)
class FoundRingDown:
    """Fit of one ring-down, or of several together.

    Attributes:
        run: fitted run. For several runs, the first one with the largest clock uncertainties of all.
        sources: logs of all runs.
        fit: fit.
        tests: test names of all runs.
        mass_kg: total moving mass of the fit, kg.
    """

    run: Run
    fit: RingDownFit
    sources: Sources
    tests: tuple[str, ...]
    mass_kg: float

    @property
    def estimate(self) -> Estimate:
        """The fit as an Estimate."""
        return ring_down_estimate(self.run, self.fit, self.mass_kg, self.sources)


def fit_ring_downs(
    runs: Sequence[Run], mass_kg: float, setting: Setting, notify: Callable[[str], None], without: Collection[str] = ()
) -> tuple[list[FoundRingDown], list[str]]:
    """Fit ring-downs.

    Turned sensors measure the weak direction of a pull superposed on the strong one. A joint fit may therefore succeed
    if the fit of a single run fails.

    Args:
        runs: ring-downs.
        mass_kg: total moving mass, kg.
        setting: effort of the fits.
        notify: called with one line of text before each fit, and for each attempt of a long one.
        without: rungs of the ladder that are not used.
    Returns:
        Fits, and a message for each run or sensor that was left out.
    """
    found: list[FoundRingDown] = []
    alone: list[FoundRingDown] = []
    failed: dict[str, Run] = {}
    warnings: list[str] = []
    for recorded in runs:
        notify(f"{recorded.test}: fitting {Path(recorded.source).name}")
        run, dead = living_lasers(recorded)
        warnings += dead
        has_both = bool(len(run.x_time_s) and len(run.y_time_s))
        try:
            if has_both:
                fit = fit_ring_down_runs([run], mass_kg, setting=setting, without=without, notify=notify)
                fit = as_mounted(fit, run.turn_deg)
                alone.append(FoundRingDown(run, fit, (run.source,), (run.test,), mass_kg))
            else:
                fit = fit_one_laser(run, mass_kg, setting, without, notify)
                found.append(FoundRingDown(run, fit, (run.source,), (run.test,), mass_kg))
        except IdentificationError as error:
            sentence = f"{run.test} left out: {error}"
            warnings.append(sentence)
            if has_both and abs(run.turn_deg) > AXIS_TOLERANCE_DEG:
                failed[sentence] = run
    pairs = [one.run for one in alone] + list(failed.values())
    if len(pairs) > 1 and (failed or any(not _resolves_directions(one.fit) for one in alone)):
        try:
            fit = fit_ring_down_runs(pairs, mass_kg, setting=setting, without=without, notify=notify)
            fit = as_mounted(fit, pairs[0].turn_deg)
        except IdentificationError as error:
            warnings.append(f"joint fit of the ring-downs failed: {error}")
        else:
            sources, tests = tuple(run.source for run in pairs), tuple(run.test for run in pairs)
            alone = [FoundRingDown(_joined(pairs), fit, sources, tests, mass_kg)]
            warnings = [sentence for sentence in warnings if sentence not in failed]
    return [*found, *alone], warnings


def _resolves_directions(fit: RingDownFit) -> bool:
    return "axis_angle_deg" in fit.values and fit.std["axis_angle_deg"] < 1.0


def _joined(runs: list[Run]) -> Run:
    """First run with the largest clock uncertainties of all runs, for the joint fit."""
    return replace(runs[0], test="ring-down", **joined_rates(runs))
