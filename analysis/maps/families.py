"""Borders of stability for several values of a number, and the value with the greatest stable share of a map."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from rig_configs import RigFileError
from rig_configs.physical_numbers import need_physical_key

_SCAN_VALUES = 9  # values of the scan before the bounded search
_SEARCH_TOLERANCE = 2e-3  # of the bounded search, relative to its interval


@dataclass(frozen=True)
class BorderFamily:
    """Values of a number for which borders are followed.

    Attributes:
        keys: keys of the rig file; several have equal values.
        values: at least one value, rising.
    Raises:
        RigFileError: an unknown number, no values, or values that do not rise.
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
        """The keys as on the command line."""
        return "+".join(self.keys)

    def as_json(self) -> dict[str, Any]:
        """Return plain numbers and texts for `of_json`."""
        return {"keys": list(self.keys), "values": list(self.values)}

    @classmethod
    def of_json(cls, table: Mapping[str, Any]) -> BorderFamily:
        """Return the family of an `as_json` table."""
        return cls(tuple(map(str, table["keys"])), tuple(map(float, table["values"])))


@dataclass(frozen=True)
class SearchRange:
    """Range of a number in which the largest stable share is searched.

    Attributes:
        keys: keys of the rig file; several have equal values.
        low, high: ends of the range.
        logarithmic: whether the scan is even in the logarithm.
    Raises:
        RigFileError: an unknown number, an empty range, or a logarithm of a number that is not positive.
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
        """The keys as on the command line."""
        return "+".join(self.keys)

    def as_json(self) -> dict[str, Any]:
        """Return plain numbers and texts for `of_json`."""
        return {"keys": list(self.keys), "from": self.low, "to": self.high, "logarithmic": self.logarithmic}

    @classmethod
    def of_json(cls, table: Mapping[str, Any]) -> SearchRange:
        """Return the range of an `as_json` table."""
        keys = tuple(map(str, table["keys"]))
        return cls(keys, float(table["from"]), float(table["to"]), bool(table["logarithmic"]))


@dataclass(frozen=True)
class BestValue:
    """Value of a number with the greatest stable share of a map.

    Attributes:
        values, shares: all computed values, rising, and the stable share at each, shape (n,).
        unresolved: share of the plane that the borders leave undecided at each value, shape (n,); it may be stable.
        value: best value.
        interval: nearest values on both sides, or ends of the range, whose shares are smaller by more than
            `share_error` with the unresolved share counted as stable. A single maximum in the range lies between them,
            smooth or at a corner.
        share: stable share at the best value.
        share_error: error bound of that share, from its change by another halving of the borders' grid.
        at_end: whether the best value is an end of the range, so that a wider range may contain a better one.
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
    """Search the greatest share: nine values over the range, then a bounded search around the best of them.

    A second, higher maximum narrower than an eighth of the range may be missed.

    Args:
        share: returns the stable share at a value, 0 … 1, and the undecided share.
        share_error: returns the error of the stable share at a value.
        within: range of the search.
        progress: called with the completed share.
    """
    to, back = (math.log, math.exp) if within.logarithmic else (float, float)
    ends = to(within.low), to(within.high)
    known = dict[float, tuple[float, float]]()
    expected = _SCAN_VALUES + 18

    def value_of(place: float) -> float:  # exp(log(A)) may differ from A by rounding
        return within.low if place == ends[0] else within.high if place == ends[1] else back(place)

    def at(place: float) -> float:
        if place not in known:
            known[place] = share(value_of(place))
            progress(min(0.95, len(known) / expected))
        return known[place][0]

    scan = np.linspace(*ends, _SCAN_VALUES)
    top = int(np.argmax([at(place) for place in scan.tolist()]))
    bounds = float(scan[max(top - 1, 0)]), float(scan[min(top + 1, _SCAN_VALUES - 1)])

    def lost(place: float) -> float:
        return -at(float(place))

    tolerance = _SEARCH_TOLERANCE * (bounds[1] - bounds[0])
    scipy.optimize.minimize_scalar(lost, bounds=bounds, method="bounded", options={"xatol": tolerance})
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
