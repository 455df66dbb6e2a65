"""parameters.toml: results of an identification, with covariance and provenance."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from dynamics.equations.parameters import RotorParameters
from rig_basics.arrays import Array
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_basics.whole_file import write_whole_text
from rig_configs.drag import Drag
from rig_configs.error_label import ErrorLabel
from rig_configs.errors import ParametersFileError, RigFileError
from rig_configs.known import KnownNumbers, KnownSource
from rig_configs.physical_numbers import PARAMETERS
from rig_configs.slow_roll import SlowRoll
from rig_configs.suspension_terms import SuspensionTerms
from rig_configs.toml_text import parse_toml, read_text

PARAMETER_UNITS: Mapping[str, str] = {name: each.unit for name, each in PARAMETERS.items()}
PARAMETER_SYMBOLS: Mapping[str, str] = {name: each.symbol for name, each in PARAMETERS.items()}
_ROUNDING = 1e-6  # relative error of a variance that is printed with few digits


@dataclass(frozen=True)
class IdentifiedParameters(Tabular):
    """Identified values with their joint covariance.

    Attributes:
        values: name to value (SI), in the order of the covariance.
        covariance: shape (n, n), products of the values' units.
        provenance: further facts: logs with digests, method, software version, consistency.
        axis_angle_deg: angle from the stiffness x axis to the sensor x axis and its standard uncertainty, degrees, not
            correlated with the values; None if no test identified it.
        shared: label of an error shared with other quantities → shift of the values per standard deviation of it,
            shape (n,), part of the covariance.
        by_number: known number of the rig file → derivative of the values by it, shape (n,).
        slow_roll: run-out and bow identified by a run-up; None without.
        terms: changes of the suspension with the motion, identified by ring-downs; None without.
    Raises:
        ParametersFileError: unknown names, a covariance of the wrong shape, not symmetric or not positive, or an axis
            angle that is not a finite number with a standard uncertainty.
    """

    values: dict[str, float]
    covariance: Array
    provenance: dict[str, Any] = field(default_factory=dict[str, Any])
    axis_angle_deg: tuple[float, float] | None = None
    shared: Mapping[ErrorLabel, Array] = field(default_factory=dict[ErrorLabel, Array])
    by_number: Mapping[str, Array] = field(default_factory=dict[str, Array])
    slow_roll: SlowRoll | None = None
    terms: SuspensionTerms | None = None

    def __post_init__(self) -> None:
        n = len(self.values)
        unknown = sorted(set(self.values) - set(PARAMETER_UNITS))
        if unknown:
            raise ParametersFileError(f"unknown parameters {unknown}; known: {list(PARAMETER_UNITS)}")
        for name, value in self.values.items():
            if not math.isfinite(value):
                raise ParametersFileError(f"{name}: expected a finite number, got {value}")
        cov = self.covariance
        if cov.shape != (n, n) or not np.all(np.isfinite(cov)):
            raise ParametersFileError(f"covariance must be a finite {n} × {n} matrix, got shape {cov.shape}")
        if np.any(np.diag(cov) < 0):
            raise ParametersFileError("covariance must be symmetric with no negative variance")
        std = np.sqrt(np.diag(cov))
        if np.any(np.abs(cov - cov.T) > 1e-9 * np.outer(std, std) + 1e-300):
            raise ParametersFileError("covariance must be symmetric with no negative variance")
        known = std > 0
        above_one = np.any(np.abs(cov) > (1 + _ROUNDING) * np.outer(std, std) + 1e-300)
        if above_one or (known.any() and np.linalg.eigvalsh(self.correlation[np.ix_(known, known)])[0] < -_ROUNDING):
            raise ParametersFileError(
                "covariance must have no negative variance in any direction (be positive semidefinite); two parameters "
                "are correlated by more than 1"
            )
        for name, shift in (*_texts(self.shared).items(), *self.by_number.items()):
            if shift.shape != (n,) or not np.all(np.isfinite(shift)):
                raise ParametersFileError(
                    f"{name!r}: expected {number_of(n, 'finite number')}, got shape {shift.shape}"
                )
        angle = self.axis_angle_deg
        if angle is not None and not (all(map(math.isfinite, angle)) and angle[1] >= 0):
            raise ParametersFileError(f"axis_angle: expected finite value_deg and std_deg, not negative, got {angle}")

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def heading(self) -> str:
        """What the table contains, with the axis angle."""
        angle = "" if self.axis_angle_deg is None else ", axis angle {:.4g}° ± {:.2g}°".format(*self.axis_angle_deg)
        return f"identified parameters{angle}"

    def columns(self) -> Mapping[str, Column]:
        """Return each value with its standard deviation and unit."""
        return {
            "name": list(self.values),
            "value": list(self.values.values()),
            "std": list(self.std.values()),
            "unit": [PARAMETER_UNITS[name] for name in self.values],
        }

    @property
    def correlation(self) -> Array:
        """Correlation matrix, shape (n, n)."""
        s = np.sqrt(np.diag(self.covariance))
        unit = np.where(s > 0, s, 1.0)
        correlation = self.covariance / unit / unit[:, None]
        correlation[np.diag_indices(len(s))] = 1.0
        return correlation

    def applied_to(self, physics: RotorParameters) -> RotorParameters:
        """Return the rig's parameters with the identified values in place of the file's."""
        return self.with_effects(physics.with_values(**self.values))

    def with_effects(self, physics: RotorParameters) -> RotorParameters:
        """Return the rig's parameters with the identified effects besides the values: suspension terms, drag, bow."""
        if self.terms is not None:
            physics = self.terms.applied_to(physics)
        if drag := Drag.of(self.provenance):
            physics = drag.on(physics)
        bow = self.slow_roll.bow_m if self.slow_roll else 0j
        return replace(physics, bow_x_m=bow.real, bow_y_m=bow.imag) if bow else physics

    def without(self, names: Collection[str]) -> IdentifiedParameters:
        """Return the parameters without some of the values; the others keep their own covariance."""
        kept = [j for j, name in enumerate(self.values) if name not in names]
        values = {name: value for name, value in self.values.items() if name not in names}
        shared = {label: shift[kept] for label, shift in self.shared.items()}
        by_number = {number: slope[kept] for number, slope in self.by_number.items()}
        covariance = self.covariance[np.ix_(kept, kept)]
        return replace(self, values=values, covariance=covariance, shared=shared, by_number=by_number)

    def missing(self, physics: RotorParameters, exact: Collection[str] = ()) -> dict[str, tuple[float, float]]:
        """Return the values that are not identified, and that the rig gives: name → value, standard uncertainty.

        Args:
            physics: rig's parameters.
            exact: names of values that are taken as exact, because they were set. The others have the design
                share of `PARAMETERS`.
        """
        return {
            name: (value, 0.0 if name in exact else PARAMETERS[name].design_share * abs(value))
            for name, value in physics.identified().items()
            if name not in self.values
        }

    def completed(self, physics: RotorParameters, exact: Collection[str] = ()) -> IdentifiedParameters:
        """Return the parameters with the missing values of the rig; arguments as in `missing`."""
        found = self.missing(physics, exact)
        missing = {name: value for name, (value, _) in found.items()}
        n, m = len(self.values), len(missing)
        covariance = np.diag(np.r_[np.zeros(n), [std**2 for _, std in found.values()]])
        covariance[:n, :n] = self.covariance
        shared = {label: np.r_[shift, np.zeros(m)] for label, shift in self.shared.items()}
        by_number = {number: np.r_[slope, np.zeros(m)] for number, slope in self.by_number.items()}
        values = {**self.values, **missing}
        return replace(self, values=values, covariance=covariance, shared=shared, by_number=by_number)

    @property
    def own_covariance(self) -> Array:
        """Covariance without the shared errors, shape (n, n), positive semidefinite."""
        own = self.covariance - sum((np.outer(v, v) for v in self.shared.values()), np.zeros_like(self.covariance))
        std = np.sqrt(np.diag(self.covariance))
        unit = np.where(std > 0, std, 1.0)
        sizes, turn = np.linalg.eigh(0.5 * (own + own.T) / np.outer(unit, unit))
        return (turn * np.maximum(sizes, 0.0)) @ turn.T * np.outer(unit, unit)

    def shift_by(self, source: KnownSource) -> Array:
        """Return the shift of the values per standard deviation of a known number's source, shape (n,)."""
        parts = [self.by_number[number] * step for number, step in source.effects.items() if number in self.by_number]
        return np.sum([np.zeros(len(self.values)), *parts], axis=0)

    def shared_with(self, known: KnownNumbers) -> dict[ErrorLabel, Array]:
        """Return the shared errors with the current uncertainties of the rig file's known numbers.

        Values without derivatives by these numbers keep the errors of their identification.
        """
        if not self.by_number:
            return dict(self.shared)
        own = {label: shift for label, shift in self.shared.items() if label.kind != "known"}
        return own | {source.label: self.shift_by(source) for source in known.sources}

    def save(self, path: str | Path) -> None:
        """Write parameters.toml; the file is complete, or as it was."""
        document = tomlkit.document()
        document.add(tomlkit.comment("Identified parameters, in place of the values of a rig file."))
        for name, value in self.values.items():
            document[name] = {"value": value, "std": self.std[name], "unit": PARAMETER_UNITS[name]}
        document["covariance"] = {"order": list(self.values), "matrix": self.covariance.tolist()}
        for key, vectors in (("shared", _texts(self.shared)), ("by_number", self.by_number)):
            if vectors:
                document[key] = {name: vector.tolist() for name, vector in vectors.items()}
        if self.axis_angle_deg is not None:
            document["axis_angle"] = dict(zip(("value_deg", "std_deg"), self.axis_angle_deg, strict=True))
        if self.slow_roll is not None:
            document["slow_roll"] = self.slow_roll.table()
        if self.terms is not None:
            document["suspension_terms"] = self.terms.table()
        document["provenance"] = self.provenance
        write_whole_text(path, tomlkit.dumps(document))

    @staticmethod
    def label(path: str | Path) -> str:
        """Return the name of a parameters file with the start of its digest, for logs and verdicts."""
        return f"{Path(path).name} sha256:{hashlib.sha256(Path(path).read_bytes()).hexdigest()[:12]}"

    @classmethod
    def load(cls, path: str | Path) -> IdentifiedParameters:
        """Read parameters.toml.

        Raises:
            ParametersFileError: the file is missing, is not TOML, or has no values or covariance.
        """
        try:
            text = read_text(Path(path))
        except OSError as error:
            raise ParametersFileError(f"{path}: cannot be read: {error}. `rig identify` writes one") from error
        except RigFileError as error:
            raise _no_parameters(path, error) from error
        return cls.from_text(text, path)

    @classmethod
    def from_text(cls, text: str, path: str | Path) -> IdentifiedParameters:
        """Return the parameters in the text of a parameters.toml.

        Args:
            text: TOML.
            path: origin of the text, for messages.
        Raises:
            ParametersFileError: the text is not TOML, or has no values or covariance.
        """
        try:
            raw = parse_toml(text, str(path))
        except RigFileError as error:
            raise _no_parameters(path, error) from error
        try:
            order = raw["covariance"]["order"]
            values = {name: _number(raw[name]["value"]) for name in order}
            matrix = np.array([[_number(cell) for cell in row] for row in raw["covariance"]["matrix"]])
            angle = raw.get("axis_angle")
            axis = None if angle is None else (_number(angle["value_deg"]), _number(angle["std_deg"]))
            shared = {ErrorLabel.read(text): shift for text, shift in _vectors(raw.get("shared", {})).items()}
            by_number = _vectors(raw.get("by_number", {}))
            slow_roll = SlowRoll.of_table(raw["slow_roll"]) if "slow_roll" in raw else None
            terms = SuspensionTerms.of_table(raw["suspension_terms"]) if "suspension_terms" in raw else None
            return cls(values, matrix, dict(raw.get("provenance", {})), axis, shared, by_number, slow_roll, terms)
        except ParametersFileError as error:
            raise ParametersFileError(f"{path}: {error}") from error
        except (KeyError, TypeError, ValueError) as error:
            raise ParametersFileError(
                f"{path}: expected parameters as `rig identify` writes them: a table each, [covariance] with order "
                f"and matrix; problem: {error!r}"
            ) from error


def filled_remarks(filled: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return the sentence that names values of the rig file in place of identified ones; empty if there are none.

    Args:
        filled: name → value, standard uncertainty, as from `IdentifiedParameters.missing`.
    """
    if not filled:
        return []
    each = [f"{name} {value:.5g} ± {std:.2g}" for name, (value, std) in filled.items()]
    return [
        f"not identified, the rig file's design value is used: {', '.join(each)}; a test of each gives its own value"
    ]


def _no_parameters(path: str | Path, error: RigFileError) -> ParametersFileError:
    log = Path(path).suffix in (".mcap", ".part")
    return ParametersFileError(f"{path}: this is a log; `rig identify` makes parameters of it" if log else str(error))


def _texts(shared: Mapping[ErrorLabel, Array]) -> dict[str, Array]:
    return {label.text: shift for label, shift in shared.items()}


def _vectors(table: Mapping[str, Any]) -> dict[str, Array]:
    return {str(name): np.array([_number(cell) for cell in cells]) for name, cells in table.items()}


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"expected a number, got {str(value)[:40]!r}")
    return float(value)
