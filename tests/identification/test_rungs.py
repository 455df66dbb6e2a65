"""Rungs of the model ladders that are held back: they are not used even if the data require them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import get_args

import pytest

from benchmarks.worlds import Effects, Spread, draw_world, record
from daq.signals.run import Run
from identification import Identification, NotIdentifiable, identify
from identification.rungs import RUNGS, Rung, held_back
from rig_configs import Rig
from tests.effort import thorough

SEED = 1000


@lru_cache
def recorded(test: str, effects: Effects) -> tuple[Rig, Run]:
    """One recording for the identifications with and without a rung."""
    world = draw_world(SEED, Spread.exact(), effects)
    return world.rig, record(world, SEED, test)


def identified(test: str, effects: Effects, without: tuple[str, ...]) -> Identification:
    rig, run = recorded(test, effects)
    return identify([run], rig, without=without)


def has_warning(found: Identification, words: str) -> bool:
    return any(words in warning for warning in found.warnings)


@pytest.mark.parametrize(
    ("rung", "test", "effects", "words"),
    [
        ("lines", "ring-down-x", Effects(hum_m=2e-5), "50.00 Hz"),
        ("amplitude", "ring-down-x", Effects(cubic=0.01), "at zero amplitude"),
        ("slow-roll", "run-up", Effects(runout_m=1e-4), "run-out"),
    ],
)
def test_a_rung_that_is_held_back_is_not_taken(rung: str, test: str, effects: Effects, words: str) -> None:
    free, held = identified(test, effects, ()), identified(test, effects, (rung,))
    assert has_warning(free, words)
    assert not has_warning(held, words)
    assert "without" not in free.parameters.provenance
    assert held.parameters.provenance["without"] == [rung]
    shared = set(free.parameters.values) & set(held.parameters.values)
    assert any(free.parameters.values[n] != held.parameters.values[n] for n in shared)


def test_wander_held_back_leaves_a_straight_line() -> None:
    effects = Effects(wander_m=2e-5)
    free, held = identified("ring-down-x", effects, ()), identified("ring-down-x", effects, ("wander",))
    assert "cubic" in free.fits[0].fit.model
    assert "cubic" not in held.fits[0].fit.model


def test_noise_is_white_where_its_spectrum_is_held_back() -> None:
    """Intervals still take the residuals' spectrum in, so they grow."""
    effects = replace(Effects(), wander_m=3e-5)
    free, held = identified("ring-down-x", effects, ()), identified("ring-down-x", effects, ("spectrum", "wander"))
    assert held.fits[0].fit.chi2_per_dof > 1.5 * free.fits[0].fit.chi2_per_dof


def test_there_are_no_other_rungs() -> None:
    assert set(RUNGS) == set(get_args(Rung))
    with pytest.raises(ValueError, match=r"expected some of lines.*got colour"):
        held_back(["lines", "colour"])


@thorough
def test_friction_and_drag_held_back_leave_viscous_damping() -> None:
    """A spin-down alone then gives c without friction: the interval does not contain its uncertainty."""
    free, held = identified("spin-down", Effects(), ()), identified("spin-down", Effects(), ("friction", "drag"))
    name = "c3_Nms_per_rad"
    assert held.parameters.std[name] < 0.3 * free.parameters.std[name]
    dry = Effects(dry=0.02)
    assert has_warning(identified("spin-down", dry, ()), "dry friction")
    with pytest.raises(NotIdentifiable, match="no model of the run-down follows"):
        identified("spin-down", dry, ("friction", "drag"))


def test_a_release_without_friction_is_viscous() -> None:
    world = draw_world(SEED, Spread.exact(), Effects())
    runs = [record(world, SEED, test) for test in ("ring-down-x", "ring-down-y", "run-up", "point-E")]
    free, held = (identify(runs, world.rig, without=rungs) for rungs in ((), ("friction",)))
    assert held.fits[-1].fit.open_friction is None
    assert free.fits[-1].fit.open_friction is not None
    assert held.parameters.std["c3_Nms_per_rad"] < free.parameters.std["c3_Nms_per_rad"]
