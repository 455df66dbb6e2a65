"""What a report is made from."""

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
    """What one test says by itself: names (with units) to values and standard deviations."""

    __test__ = False  # not a pytest class

    test: str
    source: str
    values: Mapping[str, float]
    std: Mapping[str, float]


@dataclass(frozen=True)
class ConsistencyCheck:
    """Whether tests agree on a quantity: `z` is the largest difference in standard deviations."""

    name: str
    z: float
    text: str = ""


@dataclass(frozen=True)
class ParameterChange:
    """One parameter against an earlier identification: values, change and its standard deviation, SI; chance of one as
    large where nothing has changed, all parameters having been looked at."""

    name: str
    old: float
    new: float
    change: float
    std: float
    p: float


@dataclass(frozen=True)
class Changes:
    """What changed since an earlier identification.

    Attributes:
        since: what the earlier one is called.
        words: the verdict, a sentence.
        rows: parameter by parameter.
        notes: what was taken as common to both.
    """

    since: str
    words: str
    rows: Sequence[ParameterChange]
    notes: Sequence[str] = ()


class Identification(Protocol):
    """What the report needs of an identification's result."""

    @property
    def parameters(self) -> IdentifiedParameters:
        """Joint values with covariance."""
        ...

    @property
    def estimates(self) -> Sequence[TestEstimate]:
        """Each test by itself."""
        ...

    @property
    def consistency(self) -> Sequence[ConsistencyCheck]:
        """Whether the tests agree."""
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
    """A plain Identification, for results that come from elsewhere."""

    parameters: IdentifiedParameters
    estimates: Sequence[TestEstimate] = ()
    consistency: Sequence[ConsistencyCheck] = ()
    warnings: Sequence[str] = ()
    fits: Sequence[FitCurve] = ()


@dataclass(frozen=True)
class Campaign:
    """Everything a report shows.

    Attributes:
        title: the report's heading.
        rig: the rig file the campaign was run with.
        runs: the recorded tests, in the order they were run.
        identification: parameters with their fits.
        validation: measured against predicted at the points; None when no point was run.
        axis_angle_deg: angle from the stiffness to the sensor x axis and its standard uncertainty, degrees, where it
            is not the identified one.
        devices: device name to facts about it (model, serial, firmware, port), as shown.
        losses: log to counted losses by stream; None takes them from the runs.
        truth: a simulated rig's own numbers by parameter name, for the closing comparison.
        notes: paragraphs of the operator.
        software_version, seed: as recorded with the logs.
        budgets: of the parameters and of what the model predicts at the points, by source.
        changes: against an earlier identification; None where none was given.
        what_if: settings laid over rig file and parameters; the report then answers a question and is marked so.
    """

    title: str
    rig: Rig
    runs: Sequence[Run]
    identification: Identification
    validation: Validation | None = None
    axis_angle_deg: tuple[float, float] | None = None
    devices: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    losses: Mapping[str, Mapping[str, int]] | None = None
    truth: Mapping[str, float] | None = None
    notes: Sequence[str] = ()
    software_version: str = ""
    seed: int | None = None
    what_if: Sequence[str] = ()
    budgets: Budgets | None = None
    changes: Changes | None = None
