# pyright: strict
"""Whether a guided test can be run as asked for: known before a device is opened, a drive enabled, a log begun."""

from __future__ import annotations

import math

from daq.guided_tests import kinds
from daq.guided_tests.kinds import KINDS
from rig_configs.schema import Rig

_LEAST_RPM = 1.0  # whole rpm on the drive's wire; the schema keeps limits.speed_rpm far within its 16 bits
_RAMPS_RPM_S = (0.1, 1000.0)  # finest step of the drive's ramp, and what a rig file may ask of it
_RPM = math.pi / 30


def test_names(rig: Rig) -> tuple[str, ...]:
    """Every guided test of a rig, its points as "point-NAME"."""
    return (*(name for name in KINDS if name != "point"), *(f"point-{point}" for point in rig.points))


def possible_tests(rig: Rig) -> tuple[str, ...]:
    """Those of them that the rig's devices have the signals for."""
    return tuple(test for test in test_names(rig) if not kinds.refusal(test, rig.roles))


def speed_refusal(rig: Rig, rpm: float) -> str:
    """Why the rotor is not turned at a speed; empty when it may be."""
    limit = rig.limits.speed_rpm
    if not math.isfinite(rpm) or rpm < _LEAST_RPM:
        return f"expected a speed of {_LEAST_RPM:g} to {limit:g} rpm, got {rpm:g}: nothing was turned"
    if rpm > limit:
        return (
            f"{rpm:.0f} rpm wanted, limits.speed_rpm is {limit:.0f}: nothing was turned. Ask for less, or raise the "
            "limit in the rig file if the rotor is built for it"
        )
    return ""


def ramp_refusal(rig: Rig, top_rpm: float, duration_s: float) -> str:
    """Why a run-up or a run-down is not begun; empty when it may be."""
    if not math.isfinite(duration_s) or duration_s <= 0:
        return f"expected a duration above 0 s for the ramp, got {duration_s:g} s: nothing was turned"
    if why := speed_refusal(rig, top_rpm):
        return why
    ramp = top_rpm / duration_s
    least, most = _RAMPS_RPM_S
    if not least <= ramp <= most:
        return (
            f"{top_rpm:.0f} rpm in {duration_s:g} s is a ramp of {ramp:.3g} rpm/s, the drive's go from {least:g} to "
            f"{most:g}: nothing was turned. Take {top_rpm / most:.2g} to {top_rpm / least:.0f} s"
        )
    lower, higher = sorted(w / _RPM for w in rig.physics.natural_frequencies_rad_s)
    if top_rpm <= lower:
        return (
            f"a ramp to {top_rpm:.0f} rpm passes no resonance: they are expected at {lower:.0f} and {higher:.0f} rpm. "
            f"Nothing was turned; take a top speed above {higher:.0f} rpm"
        )
    return ""


def ramp_warning(rig: Rig, top_rpm: float) -> str:
    """What a ramp to this speed can't show; empty when it passes both resonances."""
    higher = max(rig.physics.natural_frequencies_rad_s) / _RPM
    if top_rpm > higher:
        return ""
    return (
        f"the ramp ends at {top_rpm:.0f} rpm, below the resonance expected at {higher:.0f} rpm: it shows only the other"
    )


def default_top_rpm(rig: Rig) -> float:
    """Top speed of a run-up nobody gave one for: well above the higher resonance, within the limits."""
    return min(1.3 * max(rig.physics.natural_frequencies_rad_s) / _RPM, rig.limits.speed_rpm)


def refusal(rig: Rig, test: str, top_rpm: float, duration_s: float) -> str:
    """Why a guided test is not begun; empty when it may be.

    Args:
        test: one of `test_names`.
        top_rpm, duration_s: of a run-up or a run-down; the other tests have none.
    """
    if test not in test_names(rig):
        known = ", ".join(test_names(rig)).replace("point-", "point ")
        return f"{test!r}: no such test. Known: {known}"
    if why := kinds.refusal(test, rig.roles):
        return why
    if test in ("run-up", "run-down"):
        return ramp_refusal(rig, top_rpm, duration_s)
    if test.startswith("point-"):
        ratio = rig.points[test.removeprefix("point-")].speed_ratio
        return speed_refusal(rig, rig.physics.speed_rad_s(ratio) / _RPM)
    return ""
