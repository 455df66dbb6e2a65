"""Contents of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from analysis.figures.fit import FitCurve
from analysis.validation import Validation
from daq.signals.run import Run
from rig_configs import IdentifiedParameters, Rig
from uncertainty import Budgets


@dataclass(frozen=True)
class TestEstimate:
    """Estimates of one test alone: names (with units) to values and standard deviations."""

    __test__ = False  # not a pytest class

    test: str
    sources: tuple[str, ...]
    values: Mapping[str, float]
    std: Mapping[str, float]


@dataclass(frozen=True)
class ConsistencyCheck:
    """Agreement of tests on a quantity: `z` is the largest difference in standard deviations."""

    name: str
    z: float
    text: str = ""


@dataclass(frozen=True)
class ParameterChange:
    """One parameter against an earlier identification.

    Values, change and its standard deviation in SI; p: probability of a change as large by chance in any parameter.
    """

    name: str
    old: float
    new: float
    change: float
    std: float
    p: float


@dataclass(frozen=True)
class Changes:
    """Changes since an earlier identification.

    Attributes:
        since: name of the earlier identification.
        words: verdict, a sentence.
        rows: change of each parameter.
        notes: assumptions common to both.
    """

    since: str
    words: str
    rows: Sequence[ParameterChange]
    notes: Sequence[str] = ()


class ReportedIdentification(Protocol):
    """Result of an identification as the report uses it."""

    @property
    def parameters(self) -> IdentifiedParameters:
        """Joint values with covariance."""
        ...

    @property
    def estimates(self) -> Sequence[TestEstimate]:
        """Estimates of each test alone."""
        ...

    @property
    def consistency(self) -> Sequence[ConsistencyCheck]:
        """Agreement of the tests."""
        ...

    @property
    def warnings(self) -> Sequence[str]:
        """Sentences for the reader."""
        ...

    @property
    def fits(self) -> Sequence[FitCurve]:
        """Measured and fitted curves."""
        ...


@dataclass(frozen=True)
class IdentificationResult:
    """Plain implementation of Identification, for results from other sources."""

    parameters: IdentifiedParameters
    estimates: Sequence[TestEstimate] = ()
    consistency: Sequence[ConsistencyCheck] = ()
    warnings: Sequence[str] = ()
    fits: Sequence[FitCurve] = ()


@dataclass(frozen=True)
class Campaign:
    """Contents of a report.

    Attributes:
        title: heading of the report.
        rig: rig file of the campaign.
        runs: recorded tests, in chronological order.
        identification: parameters with their fits.
        validation: measured against predicted at the points; None without a recorded point.
        axis_angle_deg: angle from the stiffness to the sensor x axis and its standard uncertainty, degrees, if it
            differs from the identified one.
        devices: device name to facts about it (model, serial, firmware, port), formatted.
        losses: log to counted losses by stream; None uses those of the runs.
        truth: parameters of a simulated rig by name, for the closing comparison.
        notes: paragraphs by the operator.
        software_version, seed: as recorded with the logs.
        budgets: budgets by source of the parameters and of the predictions at the points.
        changes: changes since an earlier identification; None without one.
        what_if: settings applied to rig file and parameters; the report is then marked as a what-if report.
    """

    title: str
    rig: Rig
    runs: Sequence[Run]
    identification: ReportedIdentification
    validation: Validation | None = None
    axis_angle_deg: tuple[float, float] | None = None
    devices: Mapping[str, Mapping[str, str]] = field(default_factory=dict[str, Mapping[str, str]])
    losses: Mapping[str, Mapping[str, int]] | None = None
    truth: Mapping[str, float] | None = None
    notes: Sequence[str] = ()
    software_version: str = ""
    seed: int | None = None
    what_if: Sequence[str] = ()
    budgets: Budgets | None = None
    changes: Changes | None = None
