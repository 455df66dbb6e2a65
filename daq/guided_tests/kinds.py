# pyright: strict
"""The kinds of guided tests: rows found among the entry points of what is installed (group `rig.guided_tests`).

A test needs signals; whoever turns the rotor and holds the pendulums may be a device or the operator's hand. Commands,
importer, planner and procedures read these rows; the project's own tests are registered the same way as any other.
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
    from daq.guided_tests.table import Table
    from rig_configs.schema import Rig

GROUP = "rig.guided_tests"
SIGNALS: Mapping[str, str] = {
    "x": "displacement along x",
    "y": "displacement along y",
    "angles": "pendulum angles",
    "phase": "rotor phase",
}
"""Signals by their short names, in words."""
CHANNELS: Mapping[str, str] = {"x": "laser/x", "y": "laser/y", "angles": "pendulums", "phase": "tacho"}
"""Channels that hold them in every log."""


class Refused(ProcedureError):
    """A test is not run as asked for: nothing was turned, nothing recorded."""


@dataclass(frozen=True)
class Number:
    """A number that a test may be given.

    Attributes:
        words: what it is, with its unit.
        default: without one given; a function takes the rig and the point's name, None where there is no default.
        low, high: what it may be, both ends included.
        whole: whether it counts something.
    """

    words: str
    default: float | Callable[[Rig, str], float | None]
    low: float = float("-inf")
    high: float = float("inf")
    whole: bool = False

    def value(self, rig: Rig, point: str) -> float | None:
        """What it is where nobody gave one."""
        return self.default(rig, point) if callable(self.default) else self.default


@dataclass(frozen=True)
class Asked:
    """A test with all it was asked for.

    Attributes:
        rig: whose parameters, limits and points count.
        kind: of the test.
        test: its name in the log.
        point: name of the point; empty without one.
        numbers: a value of each of the kind's numbers.
    """

    rig: Rig
    kind: TestKind
    test: str
    point: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict[str, float])


def _nothing_against(asked: Asked) -> str:
    return ""


@dataclass(frozen=True)
class TestKind:
    """One kind of guided test.

    Attributes:
        name: as in a log; where `point` is "named", the point's name stands behind it.
        line: what it does, one line.
        needs: signals without which it shows nothing.
        turns: whether the rotor turns.
        table: its states.
        gives: parameters that identification may take from its log, by their names in parameters.toml.
        point: whether a point's name is part of its own, may be given, or neither.
        numbers: what may be given, by name.
        refusal: why it is not run as asked for; empty when it may be.
        warning: what it cannot show as asked for; empty when nothing.
        summed: for a test that is run `count` times: the whole of the runs' summaries; None for one that is run once.
    """

    __test__ = False  # not a pytest class

    name: str
    line: str
    needs: tuple[str, ...]
    turns: bool
    table: Callable[[Asked], Table]
    gives: tuple[str, ...] = ()
    point: Literal["", "named", "optional"] = ""
    numbers: Mapping[str, Number] = field(default_factory=dict[str, Number])
    refusal: Callable[[Asked], str] = _nothing_against
    warning: Callable[[Asked], str] = _nothing_against
    summed: Callable[[Sequence[Mapping[str, Any]]], Mapping[str, Any]] | None = None

    @property
    def channels(self) -> frozenset[str]:
        """Of what it needs."""
        return frozenset(CHANNELS[signal] for signal in self.needs)

    @property
    def trusts_angles(self) -> bool:
        """Whether counters that are wrong at the locks are a reason to refuse it."""
        return self.turns or "angles" in self.needs

    def lives_on(self, roles: Roles) -> tuple[str, ...]:
        """Channels that must not fall silent at rest, either: those on which it waits for a person."""
        if self.trusts_angles:
            return (CHANNELS["angles"],) if roles.angles else ()
        return tuple(sensor.topic for sensor in roles.displacements)


class _Kinds(Mapping[str, TestKind]):
    """All kinds that are installed, the project's own first in the order of a campaign; loaded when asked for."""

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
    """Entry points by name, in the order in which a campaign needs them; others follow by name."""
    found = {point.name: point for point in entry_points(group=GROUP)}
    order = {name: place for place, name in enumerate(_CAMPAIGN)}
    return {name: found[name] for name in sorted(found, key=lambda name: (order.get(name, len(order)), name))}


@cache
def _loaded(point: EntryPoint) -> TestKind:
    try:
        kind = point.load()
    except Exception as error:
        text = f"guided test {point.name!r} ({point.value}) cannot be loaded: {type(error).__name__}: {error}"
        raise Refused(text) from error
    if not isinstance(kind, TestKind) or kind.name != point.name:
        raise Refused(f"guided test {point.name!r} ({point.value}): expected a TestKind of that name, got {kind!r:.80}")
    return kind


def kind_of(test: str) -> TestKind | None:
    """The kind of a test by its name in a log; None when none is installed."""
    if test in KINDS:
        return None if KINDS[test].point == "named" else KINDS[test]
    named = (name for name in KINDS if test.startswith(f"{name}-") and KINDS[name].point == "named")
    return next((KINDS[name] for name in named), None)


def lacking(kind: TestKind, roles: Roles) -> tuple[str, ...]:
    """Signals that a rig cannot give a test, in words."""
    there = {"x": roles.along("x"), "y": roles.along("y"), "angles": roles.angles, "phase": roles.phase}
    return tuple(SIGNALS[signal] for signal in kind.needs if there[signal] is None)


def refusal(test: str, roles: Roles) -> str:
    """Why a rig cannot do a test; empty when it can."""
    kind = kind_of(test)
    missing = () if kind is None else lacking(kind, roles)
    if not missing:
        return ""
    return f"{test} needs {' and '.join(missing)}: no device of the rig file gives that. Nothing was turned"


def given_on(kind: TestKind, roles: Roles) -> tuple[str, ...]:
    """Parameters that a rig's own sensors can show of what a kind gives: one alone shows its direction's suspension."""
    axes = {sensor.axis for sensor in roles.displacements}
    hidden = {"x": ("k2", "zeta2"), "y": ("k1", "zeta1")}[axes.pop()] if len(axes) == 1 else ()
    return tuple(name for name in kind.gives if not name.startswith(hidden))
