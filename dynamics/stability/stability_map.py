"""Largest multiplier of the balanced state over two parameters of a rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynamics.arguments import check_number, real_array
from dynamics.arrays import Array, Flags
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import RigOrParameters, physics_of
from dynamics.errors import NoBalancedState, OutsideDomain
from dynamics.stability.floquet.lanes import LANES
from dynamics.stability.map_plane import Plane, RigOverPlane, RigPlane, SpeedStiffnessPlane, multiplier_at
from dynamics.stability.map_points import cores, explicit_multipliers
from dynamics.stability.map_tiles import MapTiles
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_basics.thread_pool import ThreadPool

_MAX_POINTS = 20_000_000
_MIN_RATIO, _MAX_RATIO = 1e-15, 1e15  # outside, squares and quotients exceed the range of a double
_MIN_ACCURACY = 1e-12


@dataclass(frozen=True)
class StabilityMap(Tabular):
    """The largest multiplier of Type I over a grid of two parameters of a rig.

    Attributes:
        plane: plane of the map.
        x, y: values of its parameters, shapes (n,) and (m,); in `stability_map` speed ratio Ω and stiffness ratio K.
        multiplier_max: largest modulus over one revolution, shape (m, n); NaN where the balanced state does not exist.
        error_estimate: bound on its error, shape (m, n). It exceeds the accuracy where no method reaches it (see
            `missed`).
        counts: numbers of points that were interpolated, computed explicitly in batches, and computed one by one.
        accuracy: requested accuracy.
    """

    plane: Plane
    x: Array
    y: Array
    multiplier_max: Array
    error_estimate: Array
    counts: tuple[int, int, int]
    accuracy: float

    @property
    def method(self) -> str:
        """Number of points by method, as text."""
        interpolated, explicit, one_by_one = self.counts
        return (
            f"interpolated: {interpolated}; explicit, {LANES} points at once: {explicit}; point by point: {one_by_one}"
        )

    @property
    def missed(self) -> int:
        """Number of points whose bound exceeds the requested accuracy."""
        return int(np.count_nonzero(self.error_estimate > self.accuracy * np.maximum(1.0, self.multiplier_max)))

    @property
    def heading(self) -> str:
        """Number of points and the stable fraction of those with a balanced state."""
        known = self.stable[~np.isnan(self.multiplier_max)]
        share = f"{100 * known.mean():.3g} % stable" if known.size else "no balanced state"
        return f"StabilityMap: {len(self.x)} × {number_of(len(self.y), 'point')}, {share}"

    @property
    def remarks(self) -> Sequence[str]:
        """Whether points miss the accuracy."""
        missed = number_of(self.missed, "point misses", "points miss")
        return [f"{missed} the accuracy of {self.accuracy:g}"] if self.missed else []

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each point."""
        x, y = np.meshgrid(self.x, self.y)
        names = "multiplier_max", "error_estimate", "stable"
        return dict(zip(self.plane.names, (x.ravel(), y.ravel()), strict=True)) | {
            name: getattr(self, name).ravel() for name in names
        }

    @property
    def stable(self) -> Flags:
        """Whether the largest multiplier is inside the unit circle by more than its error, shape (m, n).

        A NaN error estimate counts as zero: such a point lies between points with an error estimate.
        """
        return self.multiplier_max + np.nan_to_num(self.error_estimate) < 1.0

    @property
    def decay_rate_per_s(self) -> Array:
        """Decay rate of disturbances, −ln(multiplier_max) over the time of a revolution, 1/s, shape (m, n)."""
        grid = np.meshgrid(self.x, self.y)
        speeds = self.plane.speeds_rad_s(*(part.ravel() for part in grid)).reshape(self.multiplier_max.shape)
        return -np.log(self.multiplier_max) * speeds / (2 * np.pi)


def stability_map_over(
    at: Plane | RigOverPlane,
    x: ArrayLike,
    y: ArrayLike,
    accuracy: float = 1e-8,
    progress: Callable[[float], None] | None = None,
    threads: int | None = None,
) -> StabilityMap:
    """Compute the largest modulus of the Type I multipliers over one revolution over any two numbers.

    Args:
        at: function from a pair of values to (rig, speed in rad/s), or a plane.
        x, y: values of both numbers, shapes (n,) and (m,), finite.
        accuracy: bound on the error, relative to max(1, largest modulus); 1e-12 … 0.1.
        progress: called with the completed share of points, 0 … 1, from the calling thread.
        threads: number of threads. None: one per core. The results do not depend on it.
    Raises:
        OutsideDomain: values are not finite, the accuracy is outside the range, there are too many points, or gravity,
            a pivot shift or a bow prevents a state at rest.
        NotConverged: the multiplier of a point cannot be computed even with a low accuracy. The message contains the
            point.

    Example:
        >>> from dynamics import stability_map_over
        >>> from rig_configs import load_rig
        >>> rig = load_rig("virtual").physics
        >>> def at(k2, speed):
        ...     return rig.with_values(k2_N_per_m=k2), speed
        >>> found = stability_map_over(at, [20e3, 40e3], [20.0, 40.0])
        >>> found.multiplier_max.round(3)
        array([[1.232, 1.227],
               [1.019, 0.948]])
    """
    plane = RigPlane(at) if callable(at) else at
    x, y = (np.atleast_1d(real_array(name, values)) for name, values in (("x", x), ("y", y)))
    if x.ndim != 1 or y.ndim != 1 or not (np.all(np.isfinite(x)) and np.all(np.isfinite(y))):
        raise OutsideDomain(f"x and y must be one-dimensional and finite, got {x!r} and {y!r}")
    _check_size(len(x), len(y), accuracy)
    found, errors, counts = multipliers_on_grid(plane, x, y, accuracy, progress or _ignore, threads)
    return StabilityMap(plane, x, y, found, errors, counts, accuracy)


def _check_size(columns: int, rows: int, accuracy: float) -> None:
    check_number(accuracy=accuracy)
    if not _MIN_ACCURACY <= accuracy <= 0.1:
        raise OutsideDomain(f"accuracy must lie in {_MIN_ACCURACY:g} … 0.1, got {accuracy!r}")
    if columns * rows > _MAX_POINTS:
        raise OutsideDomain(f"a map has at most {_MAX_POINTS:.0e} points, got {columns} × {rows}")


def stability_map(
    rig: RigOrParameters,
    speed_ratios: ArrayLike,
    stiffness_ratios: ArrayLike,
    accuracy: float = 1e-8,
    progress: Callable[[float], None] | None = None,
) -> StabilityMap:
    """Compute the largest modulus of the Type I multipliers over one revolution on a grid of speed and stiffness ratio.

    Args:
        rig: RotorParameters, or an object whose `.physics` is one. k1 and the damping ratios are constant, k2 = K k1.
            Dry friction is neglected.
        speed_ratios: Ω = ω/ω_n1, shape (n,), 1e-15 … 1e15.
        stiffness_ratios: K = k2/k1, shape (m,), 1e-15 … 1e15.
        accuracy: bound on the error, relative to max(1, largest modulus); 1e-12 … 0.1.
        progress: called with the completed share of points, 0 … 1, from the calling thread.
    Raises:
        OutsideDomain: a ratio or an accuracy outside the range.
        NoBalancedState: the balanced state does not exist for these first mass moments.
        NotConverged: the multiplier of a point cannot be computed even with a low accuracy. The message contains the
            point.
    """
    speeds, stiffness = (
        np.atleast_1d(real_array("speed_ratios", speed_ratios)),
        np.atleast_1d(real_array("stiffness_ratios", stiffness_ratios)),
    )
    for name, values in (("speed_ratios", speeds), ("stiffness_ratios", stiffness)):
        if values.ndim != 1 or not np.all(np.isfinite(values) & (values > 0)):
            raise OutsideDomain(f"{name} must be one-dimensional, finite and above 0, got {values!r}")
        if np.any((values < _MIN_RATIO) | (values > _MAX_RATIO)):
            raise OutsideDomain(
                f"{name} must be above 0 and lie in {_MIN_RATIO:g} … {_MAX_RATIO:g}, got "
                f"{values.min():g} … {values.max():g}"
            )
    _check_size(len(speeds), len(stiffness), accuracy)
    parameters = physics_of(rig)
    angles = balanced_angles(parameters)
    if not angles:
        raise NoBalancedState("no balanced state to map: it needs |S_A − S_B| ≤ S_P ≤ S_A + S_B")
    type_one(parameters, *angles[0], parameters.speed_rad_s(1.0))  # raises OutsideDomain for gravity or a pivot shift
    plane = SpeedStiffnessPlane(parameters, angles[0])
    found, errors, counts = multipliers_on_grid(plane, speeds, stiffness, accuracy, progress or _ignore)
    return StabilityMap(plane, speeds, stiffness, found, errors, counts, accuracy)


def multipliers_on_grid(
    plane: Plane,
    x: Array,
    y: Array,
    accuracy: float,
    progress: Callable[[float], None],
    threads: int | None = None,
) -> tuple[Array, Array, tuple[int, int, int]]:
    """Compute the largest multipliers of Type I on a grid of a plane.

    Args:
        x, y: values of the plane's parameters, shapes (n,) and (m,).
        accuracy, progress, threads: see `stability_map_over`.
    Returns:
        Multipliers and their bounds, shape (m, n), NaN where the balanced state does not exist; numbers of points that
        were interpolated, computed explicitly in batches, and computed one by one.
    Raises:
        NotConverged: the multiplier of a point cannot be computed even with a low accuracy.
    """
    found, errors = np.full((2, len(y), len(x)), np.nan)
    with ThreadPool(threads or cores()) as pool:
        tiles = MapTiles(plane, x, y)
        for rectangle in tiles.rectangles(pool):
            for rows, columns, multipliers, bounds in tiles.multipliers(pool, rectangle):
                met = bounds <= accuracy * np.maximum(1.0, multipliers)
                place = np.ix_(rows, columns)
                found[place], errors[place] = np.where(met, multipliers, np.nan), np.where(met, bounds, np.nan)
                progress(float(1 - np.isnan(found).mean()))
        rest = np.flatnonzero(np.isnan(found))
        points = np.tile(x, len(y)), np.repeat(y, len(x))
        left = _explicit(pool, plane, points, rest, accuracy, found, errors, progress)
    for done, point in enumerate(left):
        row, column = divmod(int(point), len(x))
        found[row, column], errors[row, column] = multiplier_at(plane, float(x[column]), float(y[row]), accuracy)
        progress(1 - (len(left) - done - 1) / found.size)
    progress(1.0)  # points without a balanced state need no computation
    return found, errors, (found.size - len(rest), len(rest) - len(left), len(left))


def multipliers_at_points(
    plane: Plane,
    x: Array,
    y: Array,
    accuracy: float,
    progress: Callable[[float], None] | None = None,
) -> tuple[Array, Array]:
    """Compute the largest multipliers of Type I at scattered points.

    Args:
        x, y: coordinates of the points, shape (points,).
        accuracy, progress: see `stability_map`.
    Returns:
        Multipliers and their bounds, shape (points,), NaN where the balanced state does not exist.
    Raises:
        NotConverged: the multiplier of a point cannot be computed even with a low accuracy.
    """
    found, errors = np.full((2, len(x)), np.nan)
    notify = progress or _ignore
    with ThreadPool(cores()) as pool:
        left = _explicit(pool, plane, (x, y), np.arange(len(x)), accuracy, found, errors, notify)
    for point in left.tolist():
        found[point], errors[point] = multiplier_at(plane, float(x[point]), float(y[point]), accuracy)
    notify(1.0)
    return found, errors


def _ignore(share: float) -> None:
    del share


def _explicit(
    pool: ThreadPoolExecutor,
    plane: Plane,
    points: tuple[Array, Array],
    rest: NDArray[np.intp],
    accuracy: float,
    found: Array,
    errors: Array,
    progress: Callable[[float], None],
) -> NDArray[np.intp]:
    """Compute remaining points by explicit steps. Returns the points for which they are not suitable."""
    x, y = points
    rigs = plane.rigs(x[rest], y[rest]) if len(rest) else None
    if rigs is None:
        return rest
    there = np.flatnonzero(~np.isnan(rigs.theta_rad).any(axis=0))
    rest, rigs = rest[there], rigs.at(there)

    def done(batch: NDArray[np.intp], multipliers: Array, bounds: Array) -> None:
        found.reshape(-1)[rest[batch]], errors.reshape(-1)[rest[batch]] = multipliers, bounds
        progress(float(1 - np.isnan(found).mean()))

    return rest[explicit_multipliers(pool, rigs, accuracy, done)]
