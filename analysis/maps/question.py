"""Question of a map: all inputs that determine its arrays, with the text of the rig file; JSON in both directions."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self, cast

from analysis.maps.axes import STIFFNESS_RATIO, MapAxis
from analysis.maps.families import BorderFamily, SearchRange
from analysis.maps.planes import plane_over
from dynamics.stability.map_plane import Plane
from rig_basics.units import RPM
from rig_configs import IdentifiedParameters, ParametersFileError, Rig, RigFileError
from rig_configs.load import rig_from_text, rig_text
from rig_configs.toml_text import read_text

Quantity = Literal["multiplier", "decay-rate", "state", "amplitude", "settling-time", "coexisting"]
NONLINEAR: tuple[Quantity, ...] = ("state", "amplitude", "settling-time", "coexisting")
"""Quantities of the nonlinear motion, which take much longer: end states of releases, coexisting motions."""
_MAX_REFINE = 8
_K2 = "suspension.k2_N_per_m"


@dataclass(frozen=True)
class SourceText:
    """Text of an input file, so that the map can be computed again without the file.

    Attributes:
        source: path of the file, or name of the shipped rig.
        text: complete text.
    """

    source: str
    text: str

    @property
    def digest(self) -> str:
        """Digest of the text in UTF-8: "sha256:" and 64 hexadecimal digits."""
        return f"sha256:{hashlib.sha256(self.text.encode()).hexdigest()}"

    def as_json(self) -> dict[str, str]:
        """Return plain texts with the digest for readers; `of_json` does not need the digest."""
        return {"source": self.source, "digest": self.digest, "text": self.text}

    @classmethod
    def of_json(cls, table: Mapping[str, Any]) -> SourceText:
        """Return the text of an `as_json` table."""
        return cls(str(table["source"]), str(table["text"]))


@dataclass(frozen=True)
class MapQuestion:
    """Inputs that determine a map's arrays.

    Attributes:
        rig: rig file.
        x, y: numbers of the axes with their values.
        parameters: identified parameters applied to the rig file, or None.
        settings: "key=value" settings, applied last.
        speed_rad_s: speed of the rotor if neither axis is a speed.
        quantity: quantity of the map.
        accuracy: accuracy of the largest multiplier, relative to max(1, its modulus).
        borders: whether the borders of stability are followed too.
        refine: number of halvings of the grid's cells in both directions where stability changes; x and y are those of
            the coarse grid.
        family: values of a further number for which borders are followed, or None.
        best: range of a further number in which the largest stable share is searched, or None.
        seconds: duration of a release for quantities that need one, s.
    Raises:
        RigFileError: incompatible inputs.
    """

    rig: SourceText
    x: MapAxis
    y: MapAxis
    parameters: SourceText | None = None
    settings: tuple[str, ...] = ()
    speed_rad_s: float | None = None
    quantity: Quantity = "multiplier"
    accuracy: float = 1e-8
    borders: bool = False
    refine: int = 0
    family: BorderFamily | None = None
    best: SearchRange | None = None
    seconds: float = 20.0

    def __post_init__(self) -> None:
        if self.is_nonlinear and (self.family or self.best):
            raise RigFileError(f"map: family and best are of borders; the quantity {self.quantity} has none")
        if not 0 < self.seconds < math.inf:
            raise RigFileError(f"map: seconds: expected a number above 0, got {self.seconds!r}")
        requested = {"borders": self.borders, "refine": self.refine, "family": self.family, "best": self.best}
        for name in (name for name, value in requested.items() if value):
            if min(self.x.count, self.y.count) < 2:
                raise RigFileError(f"map: {name} needs both axes to span a range, A < B and N of at least 2")
        if not 0 <= self.refine <= _MAX_REFINE:
            raise RigFileError(f"map: refine: expected 0 … {_MAX_REFINE}, got {self.refine}")
        on_axes = {_K2 if key == STIFFNESS_RATIO else key for key in (*self.x.keys, *self.y.keys)}
        for name, varied in (("family", self.family), ("best", self.best)):
            if varied and (both := sorted({*varied.keys} & on_axes)):
                raise RigFileError(f"map: {name}: {both[0]} changes along an axis; give another number")

    @property
    def is_nonlinear(self) -> bool:
        """Whether the quantity is one of the nonlinear motion."""
        return self.quantity in NONLINEAR

    @property
    def axes(self) -> tuple[MapAxis, MapAxis]:
        """Both axes."""
        return self.x, self.y

    @property
    def fine(self) -> tuple[MapAxis, MapAxis]:
        """Both axes with the values of the finest grid."""
        x, y = (replace(axis, count=((axis.count - 1) << self.refine) + 1) for axis in self.axes)
        return x, y

    @cached_property
    def known(self) -> IdentifiedParameters | None:
        """Identified parameters.

        Raises:
            ParametersFileError: the text contains no parameters.
        """
        if self.parameters is None:
            return None
        return IdentifiedParameters.from_text(self.parameters.text, self.parameters.source)

    def loaded(self, further: Sequence[str] = ()) -> Rig:
        """Return the rig, with further settings after the question's own.

        Raises:
            RigFileError: a setting that a rig file cannot contain.
        """
        return rig_from_text(self.rig.source, self.rig.text, self.known, [*self.settings, *further])

    def plane(self, further: Sequence[str] = ()) -> Plane:
        """Return the plane of rigs over both axes.

        Args:
            further: settings after the question's own.
        Raises:
            RigFileError: an impossible value, a number on both axes, or a missing speed.
        """
        return plane_over(lambda more: self.loaded([*further, *more]), self.axes, self.speed_rad_s)

    def as_json(self) -> dict[str, Any]:
        """Return plain numbers and texts for `of_json`."""
        return {
            "rig": self.rig.as_json(),
            "parameters": None if self.parameters is None else self.parameters.as_json(),
            "settings": list(self.settings),
            "x": self.x.as_json(),
            "y": self.y.as_json(),
            "speed_rad_per_s": self.speed_rad_s,
            "quantity": self.quantity,
            "accuracy": self.accuracy,
            "borders": self.borders,
            "refine": self.refine,
            "family": None if self.family is None else self.family.as_json(),
            "best": None if self.best is None else self.best.as_json(),
            "seconds": self.seconds,
        }

    @classmethod
    def of_json(cls, table: Mapping[str, Any]) -> Self:
        """Return the question of an `as_json` table.

        Raises:
            KeyError: a key is missing.
        """
        known, speed, family, best = (table[key] for key in ("parameters", "speed_rad_per_s", "family", "best"))
        return cls(
            SourceText.of_json(table["rig"]),
            MapAxis.of_json(table["x"]),
            MapAxis.of_json(table["y"]),
            None if known is None else SourceText.of_json(known),
            tuple(map(str, table["settings"])),
            None if speed is None else float(speed),
            cast(Quantity, str(table["quantity"])),
            float(table["accuracy"]),
            bool(table["borders"]),
            int(table["refine"]),
            None if family is None else BorderFamily.of_json(family),
            None if best is None else SearchRange.of_json(best),
            float(table["seconds"]),
        )


def rig_source(path_or_name: str) -> SourceText:
    """Read a rig file or a shipped rig.

    Raises:
        RigFileError: it does not exist.
    """
    return SourceText(*rig_text(path_or_name))


def parameters_source(path: Path | None) -> SourceText | None:
    """Read a parameters file; None for None.

    Raises:
        ParametersFileError: it cannot be read, or contains no parameters.
    """
    if path is None:
        return None
    IdentifiedParameters.load(path)  # its error contains the name of the file
    try:
        return SourceText(str(path), read_text(path))
    except OSError as error:
        raise ParametersFileError(f"{path}: cannot be read: {error}") from error


def speed_of(rig: Rig, point: str | None, speed_ratio: float | None, speed_rpm: float | None) -> float | None:
    """Return the speed that is given in addition to the axes, rad/s.

    Raises:
        RigFileError: more than one speed, or an unknown point.
    """
    if sum(given is not None for given in (point, speed_ratio, speed_rpm)) > 1:
        raise RigFileError("map: expected one speed, got several; give a point, a speed ratio or a speed in rpm")
    if point is not None:
        if point not in rig.points:
            raise RigFileError(f"map: no point {point!r} in {rig.name}; known: {', '.join(rig.points)}")
        return rig.physics.speed_rad_s(rig.points[point].speed_ratio)
    if speed_ratio is not None:
        return rig.physics.speed_rad_s(speed_ratio)
    return None if speed_rpm is None else speed_rpm * RPM
