"""Select the estimators for a recorded test and the parameters that are taken from it, by its row of test kinds.

A row (`daq.guided_test_kinds`) states whether the rotor turns and which parameters its test gives. These two select
the estimators. The test's name is not used, so that a row that is added elsewhere needs no change here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

from daq.guided_test_kinds import KINDS, TestKind, kind_of, lacking
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
"""Estimators in the order of their use: name, whether the rotor turns, prefixes of the parameters they estimate."""


def methods_of(kind: TestKind) -> tuple[Method, ...]:
    """Estimators of the parameters that a kind of test gives; empty if it gives no parameter."""
    return tuple(
        method
        for method, turns, stems in _METHODS
        if turns == kind.turns and any(n.startswith(stems) for n in kind.gives)
    )


def runs_for(method: Method, runs: Iterable[Run]) -> list[Run]:
    """Runs to which an estimator is applied."""
    return [run for run in runs if (kind := kind_of(run.test)) is not None and method in methods_of(kind)]


def given_by(tests: Iterable[str]) -> frozenset[str]:
    """Parameters that may be taken from the tests with the given names."""
    return frozenset(name for test in tests if (kind := kind_of(test)) is not None for name in kind.gives)


def reduced_to_given(estimate: Estimate, tests: Iterable[str]) -> Estimate | None:
    """Return the estimate reduced to the parameters that the rows of its tests give; None if none is left."""
    given = given_by(tests)
    names = [name for name in estimate.names if name in given]
    if len(names) == len(estimate.names):
        return estimate
    return reduced(estimate, names) if names else None


def turns(test: str) -> bool:
    """Whether the rotor turns in a test; False if the table has no row for it."""
    kind = kind_of(test)
    return kind is not None and kind.turns


def pulled_along(test: str) -> str | None:
    """Axis, "x" or "y", if a test needs the displacement along one axis only; else None."""
    kind = kind_of(test)
    axes = [] if kind is None else [signal for signal in kind.needs if signal in ("x", "y")]
    return axes[0] if len(axes) == 1 else None


def skipped_tests(runs: Sequence[Run]) -> list[str]:
    """Return a message for each test to which no estimator is applied."""
    messages: list[str] = []
    for test in dict.fromkeys(run.test for run in runs):
        kind = kind_of(test)
        if kind is not None and methods_of(kind):
            continue
        why = "no known kind of test" if kind is None else "it determines no parameter"
        messages.append(f"{test} passed over: {why}; parameters come from {_able()}")
    return messages


def _able() -> str:
    return ", ".join(kind.name for kind in KINDS.values() if methods_of(kind))


def advice(missing: Sequence[str], given: Sequence[Run], roles: Roles | None = None) -> str:
    """Return the advice which tests to record for missing parameters.

    A test that was given is not proposed again. The text refers to the warnings for the reason of its failure.

    Args:
        missing: parameters that were not found.
        given: available runs.
        roles: roles of the rig. Tests whose signals the rig lacks are not proposed. None permits every test.
    """
    wanted = _wanted(missing, roles)
    tests = [run.test for run in given]
    again = sorted({t for t in tests if (k := kind_of(t)) is not None and set(methods_of(k)) & wanted.keys()})
    done = {m for t in again if (k := kind_of(t)) is not None for m in methods_of(k)}
    new = [name for method, names in wanted.items() if method not in done for name in names]
    parts = ["record " + ", ".join(dict.fromkeys(new))] if new else []
    parts += [f"the given {', '.join(again)} did not show them: the warnings contain the reason"] if again else []
    return "; ".join(parts) or "no test that this rig can do gives them"


def _wanted(missing: Sequence[str], roles: Roles | None) -> dict[Method, list[str]]:
    """Tests by estimator, with the first estimator of each missing parameter."""
    wanted: dict[Method, list[str]] = {}
    for name in missing:
        for method, _, stems in _METHODS:
            able = [kind.name for kind in kinds_for(method, [name], roles)]
            if name.startswith(stems) and able:
                wanted.setdefault(method, able)
                break
    return wanted


def kinds_for(method: Method, names: Iterable[str], roles: Roles | None = None) -> list[TestKind]:
    """Kinds of test from which an estimator finds some of the parameters: the first row for each set of signals.

    Args:
        method: estimator.
        names: parameters.
        roles: roles of the rig. Kinds whose signals the rig lacks are left out. None permits every kind.
    """
    wanted, found = set(names), dict[tuple[str, ...], TestKind]()
    for kind in KINDS.values():
        able = method in methods_of(kind) and wanted & set(kind.gives)
        if able and (roles is None or not lacking(kind, roles)):
            found.setdefault(kind.needs, kind)
    return list(found.values())
