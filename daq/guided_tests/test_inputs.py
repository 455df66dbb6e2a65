"""Check of a requested guided test before a device is opened, a drive is enabled or a log begins."""

from __future__ import annotations

import math
from collections.abc import Mapping

from daq import guided_test_kinds as kinds
from daq.guided_test_kinds import KINDS, GuidedTestRefused, GuidedTestRequest, TestKind
from rig_basics.units import RPM
from rig_configs.schema import Rig

_MIN_RPM = 1.0  # resolution of the drive's protocol; the schema limits limits.speed_rpm to far less than its 16 bits
_RAMP_RANGE_RPM_S = (0.1, 1000.0)  # resolution of the drive's ramp, and the largest ramp of a rig file


def test_names(rig: Rig) -> tuple[str, ...]:
    """Return the names of all guided tests of a rig, its points as "point-NAME"."""
    return _names(rig, separator="-")


def _names(rig: Rig, separator: str) -> tuple[str, ...]:
    """Return the names of all guided tests of a rig, with `separator` between a test and its point."""
    return tuple(
        name
        for kind in KINDS.values()
        for name in (
            (f"{kind.name}{separator}{point}" for point in rig.points) if kind.point == "named" else (kind.name,)
        )
    )


def possible_tests(rig: Rig) -> tuple[str, ...]:
    """Return the names of the guided tests whose signals the rig measures."""
    return tuple(test for test in test_names(rig) if not kinds.refusal(test, rig.roles))


def speed_refusal(rig: Rig, rpm: float) -> str:
    """Return the reason why a speed is refused; empty if it is accepted."""
    limit = rig.limits.speed_rpm
    if not math.isfinite(rpm) or rpm < _MIN_RPM:
        return f"expected a speed of {_MIN_RPM:g} to {limit:g} rpm, got {rpm:g}: nothing was turned"
    if rpm > limit:
        return (
            f"{rpm:.0f} rpm requested, limits.speed_rpm is {limit:.0f}: nothing was turned. Request a lower speed, or "
            "raise the limit in the rig file if the rotor is built for it"
        )
    return ""


def ramp_refusal(rig: Rig, top_rpm: float, duration_s: float) -> str:
    """Return the reason why a run-up or a run-down is refused; empty if it is accepted."""
    if not math.isfinite(duration_s) or duration_s <= 0:
        return f"expected a duration above 0 s for the ramp, got {duration_s:g} s: nothing was turned"
    if why := speed_refusal(rig, top_rpm):
        return why
    ramp = top_rpm / duration_s
    least, most = _RAMP_RANGE_RPM_S
    if not least <= ramp <= most:
        return (
            f"{top_rpm:.0f} rpm in {duration_s:g} s is a ramp of {ramp:.3g} rpm/s, the drive's range is {least:g} to "
            f"{most:g}: nothing was turned. Take {top_rpm / most:.2g} to {top_rpm / least:.0f} s"
        )
    lower, higher = sorted(w / RPM for w in rig.physics.natural_frequencies_rad_s)
    if top_rpm <= lower:
        return (
            f"a ramp to {top_rpm:.0f} rpm passes no resonance: they are expected at {lower:.0f} and {higher:.0f} rpm. "
            f"Nothing was turned; take a top speed above {higher:.0f} rpm"
        )
    return ""


def ramp_warning(rig: Rig, top_rpm: float) -> str:
    """Return the limitation of a ramp to this speed; empty if it passes both resonances."""
    higher = max(rig.physics.natural_frequencies_rad_s) / RPM
    if top_rpm > higher:
        return ""
    return (
        f"the ramp to {top_rpm:.0f} rpm ends below the resonance expected at {higher:.0f} rpm: it passes only the other"
    )


def default_top_rpm(rig: Rig) -> float:
    """Return the default top speed of a run-up, rpm: 1.3 times the higher resonance, at most the limit."""
    return min(1.3 * max(rig.physics.natural_frequencies_rad_s) / RPM, rig.limits.speed_rpm)


def requested_test(rig: Rig, test: str, given: Mapping[str, float] | None = None, point: str = "") -> GuidedTestRequest:
    """Return a requested test with all its numbers.

    Args:
        rig: rig with the parameters, points and limits.
        test: one of `test_names`, or a kind's name with `point`.
        given: numbers by name; the defaults of the kind apply to the others.
        point: name of a point; empty without one.

    Raises:
        GuidedTestRefused: the rig has no such test, does not measure its signals, or a number is invalid.
    """
    kind = KINDS.get(test) if point else kinds.kind_of(test)
    named = kind is not None and kind.point == "named"
    name = f"{test}-{point}" if named and point else test
    if kind is None or (named and name not in test_names(rig)):
        raise GuidedTestRefused(f"{name!r}: no such test. Known: {', '.join(_names(rig, separator=' '))}")
    point = point or kinds.point_of(name)
    if point and (not kind.point or point not in rig.points):
        takes = f"one of {', '.join(rig.points)}" if kind.point else "no point"
        raise GuidedTestRefused(f"{test} {point}: the test takes {takes}. Nothing was turned")
    if why := kinds.refusal(name, rig.roles):
        raise GuidedTestRefused(why)
    found = GuidedTestRequest(rig, kind, name, point, _numbers(rig, kind, name, dict(given or {}), point))
    if why := kind.refusal(found) or _out_of_range(found):
        raise GuidedTestRefused(why)
    return found


def _numbers(rig: Rig, kind: TestKind, test: str, given: Mapping[str, float], point: str) -> Mapping[str, float]:
    """Return a value for each number of a kind."""
    if unknown := sorted(given.keys() - kind.numbers.keys()):
        takes = ", ".join(kind.numbers) or "none"
        raise GuidedTestRefused(
            f"{test} takes no {' and no '.join(unknown)}; the numbers it takes: {takes}. Nothing was turned"
        )
    found: dict[str, float] = {}
    for name, number in kind.numbers.items():
        value = given[name] if name in given else number.value(rig, point)
        if value is None:
            or_point = " or a point of the rig" if kind.point == "optional" else ""
            raise GuidedTestRefused(f"{test}: expected {name} ({number.words}){or_point}, got none. Nothing was turned")
        found[name] = float(value)
    return found


def _out_of_range(found: GuidedTestRequest) -> str:
    for name, number in found.kind.numbers.items():
        value = found.numbers[name]
        whole = not number.whole or value == round(value)
        if not (number.low <= value <= number.high and whole):
            kind = "a whole number" if number.whole else "a number"
            wanted = f"{kind} from {number.low:g} to {number.high:g}"
            return f"{found.test}: expected {wanted} as {name} ({number.words}), got {value:g}: nothing was turned"
    return ""


def refusal(rig: Rig, test: str, given: Mapping[str, float] | None = None) -> str:
    """Return the reason why a guided test is refused; empty if it is accepted. Arguments as in `requested_test`."""
    try:
        requested_test(rig, test, given)
    except GuidedTestRefused as why:
        return str(why)
    return ""
