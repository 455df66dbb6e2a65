# pyright: strict
"""Which estimators a recorded test is given to, and which of their parameters are taken: its row of test kinds decides.

A row (`daq.guided_tests.kinds`) states whether the rotor turns and which parameters its test gives. These select the
estimators; the test's name plays no part, so a row added elsewhere needs no edit here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

from daq.guided_tests.kinds import KINDS, TestKind, kind_of, lacking
from daq.signals.run import Run
from identification.estimate import Estimate
from identification.joint.combine import reduced
from rig_configs.roles import Roles

Method = Literal["ring-down", "passage", "spin-down", "release"]

_SUSPENSION, _IMBALANCE, _DAMPING = ("k", "zeta"), ("SP",), ("c",)
_METHODS: tuple[tuple[Method, bool, tuple[str, ...]], ...] = (
    ("ring-down", False, _SUSPENSION),
    ("passage", True, (*_SUSPENSION, *_IMBALANCE)),
    ("spin-down", False, _DAMPING),
    ("release", True, _DAMPING),
)
"""Estimators in the order of their use: name, whether the rotor turns, stems of the parameters they find."""


def methods_of(kind: TestKind) -> tuple[Method, ...]:
    """Estimators that find what a kind of test gives; none where it gives nothing."""
    return tuple(
        method
        for method, turns, stems in _METHODS
        if turns == kind.turns and any(n.startswith(stems) for n in kind.gives)
    )


def runs_for(method: Method, runs: Iterable[Run]) -> list[Run]:
    """Those of the runs that an estimator is applied to."""
    return [run for run in runs if (kind := kind_of(run.test)) is not None and method in methods_of(kind)]


def given_by(tests: Iterable[str]) -> frozenset[str]:
    """Parameters that may be taken from tests, by the tests' names."""
    return frozenset(name for test in tests if (kind := kind_of(test)) is not None for name in kind.gives)


def taken(estimate: Estimate, tests: Iterable[str]) -> Estimate | None:
    """An estimate without what the rows of its tests do not give; None where nothing is left."""
    given = given_by(tests)
    names = [name for name in estimate.names if name in given]
    if len(names) == len(estimate.names):
        return estimate
    return reduced(estimate, names) if names else None


def turns(test: str) -> bool:
    """Whether the rotor turns in a test; False where the table has no row for it."""
    kind = kind_of(test)
    return kind is not None and kind.turns


def pulled_along(test: str) -> str | None:
    """The one axis, "x" or "y", whose displacement a test needs; None where it needs both or none."""
    kind = kind_of(test)
    axes = [] if kind is None else [signal for signal in kind.needs if signal in ("x", "y")]
    return axes[0] if len(axes) == 1 else None


def passed_over(runs: Sequence[Run]) -> list[str]:
    """A sentence for each test that no estimator is applied to."""
    told: list[str] = []
    for test in dict.fromkeys(run.test for run in runs):
        kind = kind_of(test)
        if kind is not None and methods_of(kind):
            continue
        why = "the table of test kinds has no row for it" if kind is None else "its row gives no parameter"
        told.append(f"{test} passed over: {why}; the table gives {_able()}")
    return told


def _able() -> str:
    return ", ".join(kind.name for kind in KINDS.values() if methods_of(kind))


def advice(missing: Sequence[str], given: Sequence[Run], roles: Roles | None = None) -> str:
    """What to record; a test that was given is to be repeated, for the reason stated in the warnings.

    Args:
        missing: parameters that were not found.
        given: the runs there are.
        roles: of the rig; tests whose signals it lacks are left out. None takes any.
    """
    wanted = _wanted(missing, roles)
    tests = [run.test for run in given]
    again = sorted({t for t in tests if (k := kind_of(t)) is not None and set(methods_of(k)) & wanted.keys()})
    done = {m for t in again if (k := kind_of(t)) is not None for m in methods_of(k)}
    new = [name for method, names in wanted.items() if method not in done for name in names]
    parts = ["record " + ", ".join(dict.fromkeys(new))] if new else []
    parts += [f"the given {', '.join(again)} did not show them: the warnings say why"] if again else []
    return "; ".join(parts) or "no test that this rig can do gives them"


def _wanted(missing: Sequence[str], roles: Roles | None) -> dict[Method, list[str]]:
    """Tests by estimator: for each missing parameter the first estimator that finds it."""
    wanted: dict[Method, list[str]] = {}
    for name in missing:
        for method, _, stems in _METHODS:
            able = [kind.name for kind in kinds_for(method, [name], roles)]
            if name.startswith(stems) and able:
                wanted.setdefault(method, able)
                break
    return wanted


def kinds_for(method: Method, names: Iterable[str], roles: Roles | None = None) -> list[TestKind]:
    """Kinds of test that an estimator finds some of the parameters from: the table's first for each set of signals.

    Args:
        roles: of the rig; kinds whose signals it lacks are left out. None takes any.
    """
    wanted, found = set(names), dict[tuple[str, ...], TestKind]()
    for kind in KINDS.values():
        able = method in methods_of(kind) and wanted & set(kind.gives)
        if able and (roles is None or not lacking(kind, roles)):
            found.setdefault(kind.needs, kind)
    return list(found.values())
