# pyright: strict
"""Borders of stability for several values of a number, and the value at which most of a map is stable."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from rig_configs import RigFileError
from rig_configs.physical_keys import need_physical_key

_SCAN = 9  # values between which a search begins
_CLOSE = 2e-3  # of two of the scan's steps: how near the search gets
_FIT = 4  # values nearest the best on which its curvature is read, at least


@dataclass(frozen=True)
class Family:
    """Values of a number for which borders are followed.

    Attributes:
        keys: of the rig file; several change alike.
        values: at least one, rising.
    Raises:
        RigFileError: no such number, no values, values that do not rise.
    """

    keys: tuple[str, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        _need_keys(self.keys)
        rising = all(a < b for a, b in zip(self.values[:-1], self.values[1:], strict=True))
        if not self.values or not all(map(math.isfinite, self.values)) or not rising:
            raise RigFileError(f"{self.key}: expected finite values that rise, got {list(self.values)}")

    @property
    def key(self) -> str:
        """The keys as the command line has them."""
        return "+".join(self.keys)

    def as_json(self) -> dict[str, Any]:
        """Plain numbers and texts."""
        return {"keys": list(self.keys), "values": list(self.values)}

    @classmethod
    def of_json(cls, table: Mapping[str, Any]) -> Family:
        """What `as_json` gave."""
        return cls(tuple(map(str, table["keys"])), tuple(map(float, table["values"])))


@dataclass(frozen=True)
class SearchRange:
    """Between which values of a number the largest stable share is looked for.

    Attributes:
        keys: of the rig file; several change alike.
        low, high: the range's ends.
        logarithmic: whether the search steps evenly in the logarithm.
    Raises:
        RigFileError: no such number, an empty range, a logarithm of what is not above 0.
    """

    keys: tuple[str, ...]
    low: float
    high: float
    logarithmic: bool = False

    def __post_init__(self) -> None:
        _need_keys(self.keys)
        if not (0.0 if self.logarithmic else -math.inf) < self.low < self.high < math.inf:
            above = "0 < A < B" if self.logarithmic else "A < B, both finite"
            raise RigFileError(f"{self.key}: expected {above}, got {self.low:g} and {self.high:g}")

    @property
    def key(self) -> str:
        """The keys as the command line has them."""
        return "+".join(self.keys)

    def as_json(self) -> dict[str, Any]:
        """Plain numbers and texts."""
        return {"keys": list(self.keys), "from": self.low, "to": self.high, "logarithmic": self.logarithmic}

    @classmethod
    def of_json(cls, table: Mapping[str, Any]) -> SearchRange:
        """What `as_json` gave."""
        keys = tuple(map(str, table["keys"]))
        return cls(keys, float(table["from"]), float(table["to"]), bool(table["logarithmic"]))


@dataclass(frozen=True)
class BestValue:
    """The value of a number at which the stable share of a map is greatest.

    Attributes:
        values, shares: every value that was tried, rising, and the stable share at it, shape (n,).
        value: the best one.
        interval: values around it whose shares cannot be told from the greatest.
        share: the greatest.
        share_error: how far it may be off: what another halving of the borders' grid changes, and how rough the
            shares around it are.
        at_end: whether the range's end is the best, so that a wider range may hold a better one.
    """

    values: NDArray[np.float64]
    shares: NDArray[np.float64]
    value: float
    interval: tuple[float, float]
    share: float
    share_error: float
    at_end: bool


def best_value(
    share: Callable[[float], float],
    share_error: Callable[[float], float],
    within: SearchRange,
    progress: Callable[[float], None],
) -> BestValue:
    """Search the greatest share: nine values spread over the range, then a bounded search beside the best of them.

    A second, higher maximum narrower than an eighth of the range may be missed.

    Args:
        share: stable share at a value, 0 … 1.
        share_error: how far that may be off.
        progress: called with the share of the work done.
    """
    to, back = (math.log, math.exp) if within.logarithmic else (float, float)
    ends = to(within.low), to(within.high)
    known = dict[float, float]()
    expected = _SCAN + 10

    def at(place: float) -> float:
        if place not in known:
            value = min(max(back(place), within.low), within.high)  # exp(log(A)) may round to below A
            known[place] = share(value)
            progress(min(0.95, len(known) / expected))
        return known[place]

    scan = np.linspace(*ends, _SCAN)
    top = int(np.argmax([at(place) for place in scan.tolist()]))
    beside = float(scan[max(top - 1, 0)]), float(scan[min(top + 1, _SCAN - 1)])
    minimize_scalar(
        lambda place: -at(float(place)), bounds=beside, method="bounded",
        options={"xatol": _CLOSE * (beside[1] - beside[0])},
    )  # fmt: skip
    best = max(known, key=lambda place: known[place])
    value = min(max(back(best), within.low), within.high)
    error = share_error(value)
    progress(1.0)
    near, rough = _indistinct(known, best, beside, error)
    places = sorted(known)
    low, high = (min(max(back(place), within.low), within.high) for place in near)
    return BestValue(
        np.array([back(place) for place in places]), np.array([known[place] for place in places]),
        value, (low, high), known[best], error + rough, best in ends,
    )  # fmt: skip


def _indistinct(
    known: Mapping[float, float], best: float, beside: tuple[float, float], error: float
) -> tuple[tuple[float, float], float]:
    """Around the best: where the shares' parabola has lost no more than their error; how rough they lie about it."""
    places = np.array(sorted(known, key=lambda place: abs(place - best)))
    width = max(float(np.abs(places[: _FIT + 1] - best).max()), 0.1 * (beside[1] - beside[0]))
    used = places[np.abs(places - best) <= width]
    shares = np.array([known[place] for place in used.tolist()])
    parabola = np.polynomial.Polynomial.fit(used, shares, 2)
    rough = float(np.sqrt(np.mean((shares - parabola(used)) ** 2))) if len(used) > 3 else 0.0
    lost = known[best] - (error + rough)
    crossings = [float(root.real) for root in (parabola - lost).roots() if abs(root.imag) < 1e-12 * width]
    least = _CLOSE * (beside[1] - beside[0])
    low = max([root for root in crossings if root < best], default=best)
    high = min([root for root in crossings if root > best], default=best)
    return (max(beside[0], min(low, best - least)), min(beside[1], max(high, best + least))), rough


def _need_keys(keys: tuple[str, ...]) -> None:
    for key in keys:
        need_physical_key(key)
