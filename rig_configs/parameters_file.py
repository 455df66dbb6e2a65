"""parameters.toml: what an identification found, with covariance and where it came from."""

from __future__ import annotations

import hashlib
import math
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from dynamics.parameters import RotorParameters
from rig_configs.errors import ParametersFileError

PARAMETER_UNITS: Mapping[str, str] = {
    "k1_N_per_m": "N/m",
    "k2_N_per_m": "N/m",
    "zeta1": "1",
    "zeta2": "1",
    "c3_Nms_per_rad": "N m s/rad",
    "c4_Nms_per_rad": "N m s/rad",
    "SP_kg_m": "kg m",
}


@dataclass(frozen=True)
class IdentifiedParameters:
    """Identified values with their joint covariance.

    Attributes:
        values: name to value (SI), in the order of the covariance.
        covariance: shape (n, n), products of the values' units.
        provenance: free facts kept with the values: logs with digests, method, software version, consistency.
        axis_angle_deg: angle from the stiffness x axis to the sensor x axis and its standard uncertainty, degrees, not
            correlated with the values; None where no test showed it.
    Raises:
        ParametersFileError: unknown names, a covariance of the wrong shape, not symmetric or not positive, or an axis
            angle that is no finite number with a standard uncertainty.
    """

    values: dict[str, float]
    covariance: np.ndarray
    provenance: dict[str, Any] = field(default_factory=dict)
    axis_angle_deg: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        n = len(self.values)
        unknown = sorted(set(self.values) - set(PARAMETER_UNITS))
        if unknown:
            raise ParametersFileError(f"unknown parameters {unknown}; known: {list(PARAMETER_UNITS)}")
        cov = self.covariance
        if cov.shape != (n, n) or not np.all(np.isfinite(cov)):
            raise ParametersFileError(f"covariance must be a finite {n} × {n} matrix, got shape {cov.shape}")
        scale = np.sqrt(np.outer(np.diag(cov), np.diag(cov)))
        if np.any(np.diag(cov) < 0) or np.any(np.abs(cov - cov.T) > 1e-9 * scale + 1e-300):
            raise ParametersFileError("covariance must be symmetric with no negative variance")
        angle = self.axis_angle_deg
        if angle is not None and not (all(map(math.isfinite, angle)) and angle[1] >= 0):
            raise ParametersFileError(f"axis_angle: expected finite value_deg and std_deg, not negative, got {angle}")

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix, shape (n, n)."""
        s = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(s, s)

    def applied_to(self, physics: RotorParameters) -> RotorParameters:
        """The rig's numbers with the identified ones in place of the file's."""
        return physics.with_values(**self.values)

    def without(self, names: Collection[str]) -> IdentifiedParameters:
        """Without some of the values: the others keep their own covariance."""
        kept = [j for j, name in enumerate(self.values) if name not in names]
        values = {name: value for name, value in self.values.items() if name not in names}
        return replace(self, values=values, covariance=self.covariance[np.ix_(kept, kept)])

    def save(self, path: str | Path) -> None:
        """Write parameters.toml."""
        document = tomlkit.document()
        document.add(tomlkit.comment("Identified parameters. Lay over a rig file with --parameters."))
        for name, value in self.values.items():
            document[name] = {"value": value, "std": self.std[name], "unit": PARAMETER_UNITS[name]}
        document["covariance"] = {"order": list(self.values), "matrix": self.covariance.tolist()}
        if self.axis_angle_deg is not None:
            document["axis_angle"] = dict(zip(("value_deg", "std_deg"), self.axis_angle_deg, strict=True))
        document["provenance"] = self.provenance
        Path(path).write_text(tomlkit.dumps(document), encoding="utf-8")

    @staticmethod
    def label(path: str | Path) -> str:
        """Which parameter set a file is, for logs and verdicts: its name and the beginning of its digest."""
        return f"{Path(path).name} sha256:{hashlib.sha256(Path(path).read_bytes()).hexdigest()[:12]}"

    @classmethod
    def load(cls, path: str | Path) -> IdentifiedParameters:
        """Read parameters.toml.

        Raises:
            ParametersFileError: the file is absent, not TOML, or lacks values or covariance.
        """
        try:
            raw = tomllib.loads(Path(path).read_text(encoding="utf-8"))
            order = raw["covariance"]["order"]
            values = {name: float(raw[name]["value"]) for name in order}
            matrix = np.array(raw["covariance"]["matrix"], float)
            angle = raw.get("axis_angle")  # older files have none
            axis = None if angle is None else (float(angle["value_deg"]), float(angle["std_deg"]))
        except OSError as error:
            raise ParametersFileError(f"{path}: cannot be read: {error}. `rig identify` writes one") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            log = Path(path).suffix in (".mcap", ".part")
            why = "this is a log; `rig identify` makes parameters of it" if log else f"not a TOML file: {error}"
            raise ParametersFileError(f"{path}: {why}") from error
        except (KeyError, TypeError, ValueError) as error:
            raise ParametersFileError(
                f"{path}: expected parameters as `rig identify` writes them: a table each, [covariance] with order "
                f"and matrix; problem: {error!r}"
            ) from error
        return cls(values, matrix, raw.get("provenance", {}), axis)
