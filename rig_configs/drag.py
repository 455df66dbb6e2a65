"""A pendulum's torque that grows with the square of the speed, identified by a spin-down, in parameters.toml.

On a rotor at rest the air drag is d |θ̇| θ̇ (the air turns with the disk) and the friction by the contact force is
F φ̇² sign θ̇. Both are equal there, because φ̇ = θ̇. On a turning rotor φ̇ ≈ ω, and F ω² is many times the drag. A release
at speed therefore distinguishes them. Source: docs/theory/pendulum_damping.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from dynamics.equations.parameters import RotorParameters
from rig_basics.arrays import Array
from rig_configs.error_label import ErrorLabel
from rig_configs.known import DRAG, KEPT_FRICTION, KnownSource

Reading = Literal["", "drag", "contact"]
"""Interpretation of a torque that grows with the square of the speed; "" if it is decided or does not exist."""

KEY = "drag"
"""Key in the provenance."""
NAMES = ("drag_a_Nms2_per_rad2", "drag_b_Nms2_per_rad2")
LABELS = (ErrorLabel("friction", "drag 1"), ErrorLabel("friction", "drag 2"))
"""Labels of the two independent parts of its error, shared by parameters and predictions."""


@dataclass(frozen=True)
class _DragSource(KnownSource):
    @property
    def label(self) -> ErrorLabel:
        """Label of the parts, which tests have identified and no rig file contains."""
        return ErrorLabel("friction", self.name)


@dataclass(frozen=True)
class Drag:
    """Torque over the square of the speed relative to the rotor, of A and B.

    Attributes:
        values: N m s²/rad², shape (2,).
        covariance: shape (2, 2).
        undecided: whether no release has shown yet that it is air drag and not friction by the contact force.
        by_number: number of the rig file → derivative of the values by it, shape (2,).
    Raises:
        ValueError: numbers that are not finite, a wrong number of values, or a negative variance.
    """

    values: Array
    covariance: Array
    undecided: bool = False
    by_number: Mapping[str, Array] = field(default_factory=dict[str, Array])

    def __post_init__(self) -> None:
        if self.values.shape != (2,) or self.covariance.shape != (2, 2):
            raise ValueError(f"drag: expected 2 values and a 2 × 2 covariance, got {self.values}, {self.covariance}")
        if wrong := [name for name, by in self.by_number.items() if by.shape != (2,)]:
            raise ValueError(f"drag: expected 2 derivatives by each number, got another count by {', '.join(wrong)}")
        if not all(np.all(np.isfinite(each)) for each in (self.values, self.covariance, *self.by_number.values())):
            raise ValueError("drag: expected finite numbers")
        if np.any(np.diag(self.covariance) < 0):
            raise ValueError("drag: expected no negative variance")

    @classmethod
    def of(cls, provenance: Mapping[str, Any]) -> Drag | None:
        """Return the drag stored in parameters.toml; None if no test identified any."""
        kept: Mapping[str, Any] | None = provenance.get(KEY)
        if not kept:
            return None
        values = np.array([float(kept["values"][name]) for name in NAMES])
        by_number = {name: np.array(by, np.float64) for name, by in kept.get("by_number", {}).items()}
        return cls(values, np.array(kept["covariance"], np.float64), bool(kept.get("undecided", False)), by_number)

    @property
    def table(self) -> dict[str, Any]:
        """Table for the provenance, under its key."""
        return {
            KEY: {
                "values": dict(zip(NAMES, self.values.tolist(), strict=True)),
                "covariance": self.covariance.tolist(),
                "undecided": self.undecided,
                "by_number": {name: by.tolist() for name, by in self.by_number.items()},
            }
        }

    @property
    def root(self) -> Array:
        """Matrix L with LLᵀ the covariance: column k is the shift of both per standard deviation of LABELS[k]."""
        first = math.sqrt(self.covariance[0, 0])
        across = float(self.covariance[0, 1]) / first if first > 0 else 0.0
        return np.array([[first, 0.0], [across, math.sqrt(max(self.covariance[1, 1] - across**2, 0.0))]])

    @property
    def sources(self) -> tuple[KnownSource, ...]:
        """Error as two independent sources for a release."""
        effects: list[dict[str, float]] = [dict(zip(DRAG, part, strict=True)) for part in self.root.T.tolist()]
        return tuple(_DragSource(label.of, 1.0, "1", by, "A") for label, by in zip(LABELS, effects, strict=True))

    def moved_with(self, sources: Sequence[KnownSource]) -> tuple[KnownSource, ...]:
        """Add to each error of a known number its effect on the drag that was identified with it."""
        return tuple(self._moved_with(source) for source in sources)

    def _moved_with(self, source: KnownSource) -> KnownSource:
        parts = [self.by_number[number] * step for number, step in source.effects.items() if number in self.by_number]
        moved = np.sum([np.zeros(2), *parts], axis=0).tolist()
        return replace(source, effects={**source.effects, **dict(zip(DRAG, moved, strict=True))}) if parts else source

    def on(self, physics: RotorParameters) -> RotorParameters:
        """Return the rig with this drag; negative values are set to 0."""
        a, b = np.maximum(self.values, 0.0).tolist()
        return replace(physics, a=replace(physics.a, drag_Nms2_per_rad2=a), b=replace(physics.b, drag_Nms2_per_rad2=b))


def read_as(provenance: Mapping[str, Any], reading: Reading) -> dict[str, Any]:
    """Return provenance in which an undecided drag is decided.

    Args:
        provenance: provenance of identified parameters.
        reading: "drag", "contact" for dry friction by the contact force, "" to leave it undecided.
    """
    drag = Drag.of(provenance)
    if drag is None or not drag.undecided or not reading:
        return dict(provenance)
    if reading == "drag":
        return {**provenance, **replace(drag, undecided=False).table}
    none = Drag(np.zeros(2), np.zeros((2, 2)))
    return {**provenance, **none.table, **_with_contact_friction(provenance, drag)}


def with_undecided_spread(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return provenance with dry friction between none and all of an undecided drag, which counts as half of it."""
    drag = Drag.of(provenance)
    if drag is None or not drag.undecided:
        return dict(provenance)
    half = 0.5 * np.maximum(drag.values, 0.0)
    return {**provenance, **_with_contact_friction(provenance, replace(drag, values=half, covariance=np.diag(half**2)))}


def _with_contact_friction(provenance: Mapping[str, Any], drag: Drag) -> dict[str, Any]:
    """Return the dry friction of provenance, by its key, with a drag added to its part by the contact force."""
    kept: Mapping[str, Any] = provenance.get("friction", {})
    values = np.array([float(kept.get("values", {}).get(name, 0.0)) for name in KEPT_FRICTION])
    covariance = np.array(kept.get("covariance", np.zeros((4, 4))), np.float64)
    values[2:] += drag.values
    covariance[2:, 2:] += drag.covariance
    named = dict(zip(KEPT_FRICTION, values.tolist(), strict=True))
    return {"friction": {"values": named, "covariance": covariance.tolist()}}
