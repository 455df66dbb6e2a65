"""Candidate experiments of a rig: a few settings for every test of the table, from short and gentle to long.

The table of test kinds contains the tests and their parameters. The expected uncertainty comes from the test's model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from daq.guided_test_kinds import TestKind, lacking
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import DynamicsError
from identification.methods import Method, kinds_for
from identification.plan.experiment import Experiment, limited
from identification.plan.pendulums import release, spin_down
from identification.plan.sensors import SensorProperties
from identification.plan.suspension import ring_down, run_up
from rig_basics.units import RPM, TO_RPM
from rig_configs.schema import Rig

_OF_LIMIT = 0.8  # share of the interlock limits that a test uses
_PLUCKS_M = (0.5e-3, 1e-3, 2.5e-3)
_FLICKS_RAD_S = (5.0, 10.0)  # below two turns a second, as the guided test requires
_RAMPS_S = (20.0, 40.0, 60.0, 120.0, 300.0)
_LONGEST_S = (20.0, 60.0, 180.0, 600.0)
_RELEASES_S = (4.0, 10.0)


def offers_for(
    rig: Rig, sensors: SensorProperties, names: Sequence[str], notify: Callable[[str], None], remarks: list[str]
) -> Iterator[Experiment]:
    """Yield every candidate experiment that shows a required parameter and whose signals the rig has.

    Args:
        rig: rig file.
        sensors: sensor properties.
        names: required parameters.
        notify: called with one line of text before each kind of test.
        remarks: receives a sentence for each test that is left out.
    """
    physics = rig.physics
    makers: dict[Method, Callable[[TestKind], Iterator[Experiment]]] = {
        "ring-down": partial(_ring_downs, rig, physics, sensors),
        "passage": partial(_run_ups, rig, physics, sensors, remarks),
        "spin-down": partial(_spin_downs, physics, sensors),
        "release": partial(_releases, rig, physics, sensors, remarks),
    }
    for method, make in makers.items():
        for kind in kinds_for(method, names):
            if without := lacking(kind, rig.roles):
                remarks.append(f"no {kind.name}: the rig file has no device for {' and '.join(without)}")
                continue
            notify(f"{kind.name} …")
            yield from filter(None, map(limited, make(kind)))


def _ring_downs(rig: Rig, physics: RotorParameters, sensors: SensorProperties, kind: TestKind) -> Iterator[Experiment]:
    for axis in (signal for signal in kind.needs if signal in sensors.axes):
        i = "xy".index(axis)
        decay = (physics.zeta1, physics.zeta2)[i] * physics.natural_frequencies_rad_s[i]
        most = _OF_LIMIT * min(rig.limits.amplitude_m, sensors.range_m[i])
        for pluck in sorted({min(p, most) for p in _PLUCKS_M}):
            for record in _lengths(decay):
                yield ring_down(physics, sensors, axis, pluck, record, kind.name)


def _lengths(decay_per_s: float) -> list[float]:
    """Return record lengths up to 4.5 time constants, s. The later decay contains almost no information."""
    whole = 4.5 / max(decay_per_s, 1e-9)
    return sorted({min(whole, longest) for longest in _LONGEST_S})


def _run_ups(
    rig: Rig, physics: RotorParameters, sensors: SensorProperties, remarks: list[str], kind: TestKind
) -> Iterator[Experiment]:
    second = max(physics.natural_frequencies_rad_s)
    top = min(1.3 * second, rig.limits.speed_rpm * RPM)
    if top < 1.05 * second:
        remarks.append(
            f"no {kind.name}: limits.speed_rpm = {rig.limits.speed_rpm:g} does not pass the second resonance at "
            f"{second * TO_RPM:.0f} rpm"
        )
        return
    refused = 0
    for ramp in _RAMPS_S:
        experiment = run_up(physics, sensors, top, ramp, kind.name)
        if experiment.largest_m > _OF_LIMIT * min(rig.limits.amplitude_m, *sensors.range_m):
            refused += 1
            continue
        yield experiment
    if refused:
        remarks.append(
            f"{refused} of {len(_RAMPS_S)} ramps of {kind.name} left out: they pass a resonance so slowly that the "
            f"displacement approaches the limit of {1e3 * rig.limits.amplitude_m:g} mm"
        )


def _spin_downs(physics: RotorParameters, sensors: SensorProperties, kind: TestKind) -> Iterator[Experiment]:
    if not (physics.a.present and physics.b.present):
        return
    rates = [p.damping_Nms_per_rad / p.inertia_kg_m2 for p in (physics.a, physics.b)]
    for flick in _FLICKS_RAD_S:
        for record in _lengths(min(rates)):
            yield spin_down(physics, sensors, flick, record, kind.name)


def _releases(
    rig: Rig, physics: RotorParameters, sensors: SensorProperties, remarks: list[str], kind: TestKind
) -> Iterator[Experiment]:
    if not (physics.a.present and physics.b.present):
        return
    for name, point in rig.points.items():
        speed = physics.speed_rad_s(point.speed_ratio)
        if point.expected == "slipping" or speed * TO_RPM > rig.limits.speed_rpm:
            continue
        test = f"{kind.name}-{name}"
        for record in _RELEASES_S:
            try:
                experiment = release(physics, sensors, test, speed, record)
            except DynamicsError as error:
                remarks.append(f"{test} left out: {error}")
                break
            if np.all(np.isfinite(experiment.expected.covariance)):
                yield experiment
