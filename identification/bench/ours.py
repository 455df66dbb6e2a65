"""This package's estimators at their three settings, as methods of the benchmark."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from identification import fit_release, fit_ring_down, fit_run_up, fit_spin_down
from identification.bench.decays import DecayTrial
from identification.bench.ramps import RampRecord
from identification.bench.releases import LOCKED_S, ZERO_STD_RAD, ReleaseRecord
from identification.bench.spins import INERTIA_KG_M2, SpinRecord
from identification.bench.trials import SETTINGS, Method, MethodResult
from identification.setting import Setting
from identification.tracking.replay import track

_BEFORE_S = 0.5  # includes two marks, so that the tracker has a phase


def methods(name: str, answer: Callable[..., MethodResult]) -> list[Method]:
    """Return one method for every setting; the balanced one, which has targets, is applied to every record."""
    return [
        Method(name, setting, partial(answer, setting=setting), every_record=setting == "balanced")
        for setting in SETTINGS
    ]


def ring_down(record: DecayTrial, setting: Setting) -> MethodResult:
    """Estimate by `fit_ring_down`."""
    return _answer(fit_ring_down(record.time_s, record.displacement_m, setting=setting))


def run_up(record: RampRecord, setting: Setting) -> MethodResult:
    """Estimate by `fit_run_up`."""
    return _answer(fit_run_up(record.time_s, record.displacement_m, record.phase_rad, setting=setting))


def spin_down(record: SpinRecord, setting: Setting) -> MethodResult:
    """Estimate by `fit_spin_down`."""
    return _answer(fit_spin_down(record.time_s, record.angle_rad, INERTIA_KG_M2, setting=setting))


def release(record: ReleaseRecord, setting: Setting) -> MethodResult:
    """Estimate by `fit_release`."""
    return _answer(fit_release(record.run, record.knowledge, ZERO_STD_RAD, setting=setting))


def tracking(record: ReleaseRecord) -> MethodResult:
    """Return the last estimate of the online tracker, started shortly before the release."""
    keep = record.run.angle_time_s > LOCKED_S - _BEFORE_S
    run = replace(record.run, angle_time_s=record.run.angle_time_s[keep], angle_rad=record.run.angle_rad[keep])
    known = record.knowledge
    last = track(run, known.physics, damping_std=np.log(10.0), imbalance_std=float(known.log_std[4])).last
    return MethodResult(last.values, last.intervals)


def _answer(fit: Any) -> MethodResult:
    return MethodResult(fit.values, fit.intervals)
