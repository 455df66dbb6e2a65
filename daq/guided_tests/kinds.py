# pyright: strict
"""The table of guided tests: what each needs of a rig.

A test needs signals; whoever turns the rotor and holds the pendulums may be a device or the operator's hand. Commands,
importer and procedures read this table; a point is the kind "point", its own name behind it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rig_configs.roles import Roles

SIGNALS: Mapping[str, str] = {
    "x": "displacement along x", "y": "displacement along y", "angles": "pendulum angles", "phase": "rotor phase",
}  # fmt: skip
"""Signals by their short names, in words."""
CHANNELS: Mapping[str, str] = {"x": "laser/x", "y": "laser/y", "angles": "pendulums", "phase": "tacho"}
"""Channels that hold them in every log."""


@dataclass(frozen=True)
class TestKind:
    """One kind of guided test.

    Attributes:
        name: as in a log; a point's name stands behind "point-".
        needs: signals without which it says nothing.
        turns: whether the rotor turns.
        gives: parameters, named as in parameters.toml, that identification may take from it.
    """

    __test__ = False  # not a pytest class

    name: str
    needs: tuple[str, ...]
    turns: bool
    gives: tuple[str, ...] = ()

    @property
    def channels(self) -> frozenset[str]:
        """Of what it needs."""
        return frozenset(CHANNELS[signal] for signal in self.needs)


_SUSPENSION = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2")
_DAMPING = ("c3_Nms_per_rad", "c4_Nms_per_rad")

KINDS: Mapping[str, TestKind] = {
    kind.name: kind
    for kind in (
        TestKind("ring-down-x", ("x",), turns=False, gives=_SUSPENSION),
        TestKind("ring-down-y", ("y",), turns=False, gives=_SUSPENSION),
        TestKind("spin-down", ("angles",), turns=False, gives=_DAMPING),
        TestKind("run-up", ("x", "y", "phase"), turns=True, gives=(*_SUSPENSION, "SP_kg_m")),
        TestKind("run-down", ("x", "y", "phase"), turns=True, gives=(*_SUSPENSION, "SP_kg_m")),
        TestKind("point", ("x", "y", "angles", "phase"), turns=True, gives=_DAMPING),
    )
}


def kind_of(test: str) -> TestKind | None:
    """The kind of a test by its name; None when there is none."""
    return KINDS.get("point" if test.startswith("point-") else test)


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
