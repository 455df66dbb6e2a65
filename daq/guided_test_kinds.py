"""Kinds of guided tests, registered as entry points of the group `rig.guided_tests` by installed packages.

A test needs signals. Rotor and locks may be operated by a device or by the operator's hand. Commands, importer, planner
and procedures use these registrations. The project's own tests are registered in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, Literal

from daq.errors import ProcedureError
from rig_configs.roles import Roles

if TYPE_CHECKING:
    from daq.guided_tests.table import StateTable
    from rig_configs.schema import Rig

GROUP = "rig.guided_tests"
SIGNALS: Mapping[str, str] = {
    "x": "displacement along x",
    "y": "displacement along y",
    "angles": "pendulum angles",
    "phase": "rotor phase",
}
"""Descriptions of the signals by their short names."""
CHANNELS: Mapping[str, str] = {"x": "laser/x", "y": "laser/y", "angles": "pendulums", "phase": "tacho"}
"""Topics of the signals in every log."""


class GuidedTestRefused(ProcedureError):
    """A test request was refused. The rotor was not turned and nothing was recorded."""


@dataclass(frozen=True)
class Number:
    """A number that a test accepts.

    Attributes:
        words: description with unit.
        default: default value, or a function of the rig and the point's name that returns it (None without default).
        low, high: permitted range, both ends included.
        whole: whether it must be an integer.
    """

    words: str
    default: float | Callable[[Rig, str], float | None]
    low: float = float("-inf")
    high: float = float("inf")
    whole: bool = False

    def value(self, rig: Rig, point: str) -> float | None:
        """Return the default value, or None if there is no default."""
        return self.default(rig, point) if callable(self.default) else self.default


@dataclass(frozen=True)
class GuidedTestRequest:
    """A requested test with all its numbers.

    Attributes:
        rig: rig with the parameters, limits and points of the test.
        kind: kind of the test.
        test: name of the test in the log.
        point: name of the point; empty without one.
        numbers: value of each number of the kind, by name.
    """

    rig: Rig
    kind: TestKind
    test: str
    point: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict[str, float])


def _no_text(request: GuidedTestRequest) -> str:
    return ""


@dataclass(frozen=True)
class TestKind:
    """One kind of guided test.

    Attributes:
        name: name of the test; if `point` is "named", the name in the log is followed by the point's name.
        summary: description in one line.
        needs: short names of the required signals.
        turns: whether the rotor turns.
        table: returns the states of the requested test.
        gives: parameters that identification may take from the log, by their names in parameters.toml.
        point: "named" if the point's name is part of the test's name, "optional" if a point may be given, "" if not.
        numbers: numbers that the test accepts, by name.
        refusal: returns the reason why a requested test is refused; empty if it is accepted.
        warning: returns the limitation of a requested test; empty if there is none.
        combined: combines the summaries of the runs of a test that is run `count` times; None for a test with one run.
    """

    __test__ = False  # not a pytest class

    name: str
    summary: str
    needs: tuple[str, ...]
    turns: bool
    table: Callable[[GuidedTestRequest], StateTable]
    gives: tuple[str, ...] = ()
    point: Literal["", "named", "optional"] = ""
    numbers: Mapping[str, Number] = field(default_factory=dict[str, Number])
    refusal: Callable[[GuidedTestRequest], str] = _no_text
    warning: Callable[[GuidedTestRequest], str] = _no_text
    combined: Callable[[Sequence[Mapping[str, Any]]], Mapping[str, Any]] | None = None

    @property
    def channels(self) -> frozenset[str]:
        """Topics of the required signals."""
        return frozenset(CHANNELS[signal] for signal in self.needs)

    @property
    def trusts_angles(self) -> bool:
        """Whether the test is refused if the counters are wrong at the closed locks."""
        return self.turns or "angles" in self.needs

    def required_at_rest(self, roles: Roles) -> tuple[str, ...]:
        """Return the channels whose silence ends the test even at rest, while it waits for the operator."""
        if self.trusts_angles:
            return (CHANNELS["angles"],) if roles.angles else ()
        return tuple(sensor.topic for sensor in roles.displacements)


class _Kinds(Mapping[str, TestKind]):
    """All installed kinds, the project's own first in the order of a campaign. Each is loaded at first use."""

    def __getitem__(self, name: str) -> TestKind:
        points = _installed()
        if name not in points:
            raise KeyError(name)
        return _loaded(points[name])

    def __iter__(self) -> Iterator[str]:
        return iter(_installed())

    def __len__(self) -> int:
        return len(_installed())


KINDS: Mapping[str, TestKind] = _Kinds()
_CAMPAIGN = ("ring-down-x", "ring-down-y", "spin-down", "run-up", "run-down", "point", "start-ups")


@cache
def _installed() -> Mapping[str, EntryPoint]:
    """Return the entry points by name, in the order of a campaign. Other tests follow in alphabetical order."""
    found = {point.name: point for point in entry_points(group=GROUP)}
    places = {name: place for place, name in enumerate(_CAMPAIGN)}
    return {name: found[name] for name in sorted(found, key=lambda name: (places.get(name, len(places)), name))}


@cache
def _loaded(point: EntryPoint) -> TestKind:
    try:
        kind = point.load()
    except Exception as error:
        text = f"guided test {point.name!r} ({point.value}) cannot be loaded: {type(error).__name__}: {error}"
        raise GuidedTestRefused(text) from error
    if not isinstance(kind, TestKind) or kind.name != point.name:
        raise GuidedTestRefused(
            f"guided test {point.name!r} ({point.value}): expected a TestKind of that name, got {kind!r:.80}"
        )
    return kind


def kind_of(test: str) -> TestKind | None:
    """Return the kind of a test by its name in a log, or None if it is not installed."""
    if test in KINDS:
        return None if KINDS[test].point == "named" else KINDS[test]
    named = (name for name in KINDS if test.startswith(f"{name}-") and KINDS[name].point == "named")
    return next((KINDS[name] for name in named), None)


def point_of(test: str) -> str:
    """Return the name of the validation point in a test's name in a log; empty for any other test."""
    kind = kind_of(test)
    return test.removeprefix(f"{kind.name}-") if kind is not None and kind.point == "named" else ""


def lacking(kind: TestKind, roles: Roles) -> tuple[str, ...]:
    """Return the descriptions of the signals that a test needs and the rig does not measure."""
    sources = {"x": roles.along("x"), "y": roles.along("y"), "angles": roles.angles, "phase": roles.phase}
    return tuple(SIGNALS[signal] for signal in kind.needs if sources[signal] is None)


def refusal(test: str, roles: Roles) -> str:
    """Return the reason why a rig cannot run a test; empty if it can."""
    kind = kind_of(test)
    missing = () if kind is None else lacking(kind, roles)
    if not missing:
        return ""
    return f"{test} needs {' and '.join(missing)}: no device of the rig file measures that. Nothing was turned"


def given_on(kind: TestKind, roles: Roles) -> tuple[str, ...]:
    """Return the parameters of a kind that the rig's sensors can measure.

    A single displacement sensor measures the suspension in its own direction only.
    """
    axes = {sensor.axis for sensor in roles.displacements}
    hidden = {"x": ("k2", "zeta2"), "y": ("k1", "zeta1")}[axes.pop()] if len(axes) == 1 else ()
    return tuple(name for name in kind.gives if not name.startswith(hidden))
