# pyright: strict, reportMissingTypeStubs=false
"""Borders of stability for several values of a number, and the value at which most of a map is stable."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar  # pyright: ignore[reportUnknownVariableType]

from rig_configs import RigFileError
from rig_configs.physical_keys import need_physical_key

_SCAN = 9  # values between which a search begins
_CLOSE = 2e-3  # of two of the scan's steps: how near the search gets


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
        unresolved: share of the plane about which the borders say nothing at each value, shape (n,); it may be stable.
        value: the best one.
        interval: the nearest values on both sides, or ends of the range, whose shares are smaller by more than
            `share_error`, what is unresolved counted as stable: with one maximum in the range it lies between them,
            whether the share bends there or has a corner.
        share: at the best value.
        share_error: how far that may be off, from what another halving of the borders' grid changes.
        at_end: whether the range's end is the best, so that a wider range may hold a better one.
    """

    values: NDArray[np.float64]
    shares: NDArray[np.float64]
    unresolved: NDArray[np.float64]
    value: float
    interval: tuple[float, float]
    share: float
    share_error: float
    at_end: bool


def best_value(
    share: Callable[[float], tuple[float, float]],
    share_error: Callable[[float], float],
    within: SearchRange,
    progress: Callable[[float], None],
) -> BestValue:
    """Search the greatest share: nine values spread over the range, then a bounded search beside the best of them.

    A second, higher maximum narrower than an eighth of the range may be missed.

    Args:
        share: stable share at a value, 0 … 1, and the share about which nothing is said.
        share_error: how far that may be off.
        progress: called with the share of the work done.
    """
    to, back = (math.log, math.exp) if within.logarithmic else (float, float)
    ends = to(within.low), to(within.high)
    known = dict[float, tuple[float, float]]()
    expected = _SCAN + 18

    def value_of(place: float) -> float:  # exp(log(A)) may be one rounding off A
        return within.low if place == ends[0] else within.high if place == ends[1] else back(place)

    def at(place: float) -> float:
        if place not in known:
            known[place] = share(value_of(place))
            progress(min(0.95, len(known) / expected))
        return known[place][0]

    scan = np.linspace(*ends, _SCAN)
    top = int(np.argmax([at(place) for place in scan.tolist()]))
    beside = float(scan[max(top - 1, 0)]), float(scan[min(top + 1, _SCAN - 1)])

    def lost(place: float) -> float:
        return -at(float(place))

    minimize_scalar(lost, bounds=beside, method="bounded", options={"xatol": _CLOSE * (beside[1] - beside[0])})
    places = sorted(known)
    shares, unresolved = (np.array(found) for found in zip(*(known[place] for place in places), strict=True))
    best = int(np.argmax(shares))
    values = [value_of(place) for place in places]
    error = share_error(values[best])
    progress(1.0)
    clear = [i for i in range(len(places)) if shares[i] + unresolved[i] < shares[best] - error]
    low = max((i for i in clear if i < best), default=0)
    high = min((i for i in clear if i > best), default=len(places) - 1)
    return BestValue(
        np.array(values),
        shares,
        unresolved,
        values[best],
        (values[low], values[high]),
        float(shares[best]),
        error,
        best in (0, len(places) - 1),
    )


def _need_keys(keys: tuple[str, ...]) -> None:
    for key in keys:
        need_physical_key(key)
