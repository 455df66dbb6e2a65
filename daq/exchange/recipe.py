"""Options of an import: assignment of the columns with their units, and the kind of test."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from typing import Annotated, Literal

from pydantic import BaseModel, Field, ValidationError, model_validator

from daq.exchange.errors import ExchangeError
from daq.exchange.units import ColumnChoice, Quantity, parse_column
from daq.log.time_span import LATEST_NS, TimeSpan

QUANTITIES: dict[str, Quantity] = {
    "time": "time",
    "x": "length",
    "y": "length",
    "theta3": "angle",
    "theta4": "angle",
    "phase": "angle",
    "marks": "time",
    "speed": "speed",
}
_ROTOR = ("phase", "marks", "speed")
_SENSORS = tuple(name for name in QUANTITIES if name != "time")

Finite = Annotated[float, Field(allow_inf_nan=False)]


class Recipe(BaseModel, extra="forbid", frozen=True):
    """Options of an import. Columns are written ``NAME:UNIT``, see daq.exchange.units.parse_column.

    Attributes:
        test: "ring-down-x", "ring-down-y", "spin-down", "run-up", "run-down", "point-NAME" or any other name.
        point: name of a validation point; the default test is "point-NAME".
        note: note of the operator.
        time: column of the sample times. Alternative: rate_Hz, the rate of the rows, Hz.
        x, y: displacements of the disk's centre.
        theta3, theta4: pendulum angles relative to the rotor.
        phase: rotor angle ψ in every row. Alternatives: marks, the times of the index marks, as a column or a separate
            file; speed, which is integrated.
        start: time 0 of the recording, ISO 8601, UTC if it contains no zone.
        release_s: times of the releases of pendulums A and B in the recording's time, s; a single time applies to both.
        counts_per_revolution: counts of the encoders, if different from the rig file.
        invalid: values that mean "no reading", as in the file.
        clock_tolerance_ppm: standard uncertainty of the rate of the recording's clock, ppm; None: from the rig file if
            it is stated there, otherwise 50 ppm.
        decimal: decimal sign of a text file, "." or ","; the other sign separates thousands. None: it is found.
        from_s, to_s: begin and end of the part that is imported, in the recording's time as `release_s`, s; None: open.
        recorder: name of the recorder; recordings of one recorder share its clock's error. Recordings without a name
            count as one recorder's.
    """

    test: str = ""
    point: str = ""
    note: str = ""
    # pylint: disable=duplicate-code  # the options of `rig import` have the names of these fields
    time: str | None = None
    rate_Hz: Annotated[float, Field(gt=0, le=1e8)] | None = None
    x: str | None = None
    y: str | None = None
    theta3: str | None = None
    theta4: str | None = None
    phase: str | None = None
    marks: str | None = None
    speed: str | None = None
    start: str | None = None
    release_s: tuple[Finite, ...] = Field(default=(), max_length=2)
    counts_per_revolution: Annotated[int, Field(ge=64)] | None = None
    invalid: tuple[float, ...] = ()
    clock_tolerance_ppm: Annotated[float, Field(ge=0, le=1e5)] | None = None
    recorder: str = ""
    decimal: Literal[".", ","] | None = None
    from_s: Finite | None = None
    to_s: Finite | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> Recipe:
        if not self.test_name:
            raise ValueError("test: expected the test's name, such as ring-down-x, or the name of a point")
        if not any(getattr(self, name) for name in _SENSORS):
            raise ValueError(f"expected at least one of {', '.join(_SENSORS)}")
        rotor = [name for name in _ROTOR if getattr(self, name)]
        if len(rotor) > 1:
            raise ValueError(f"expected one of phase, marks and speed, got {' and '.join(rotor)}")
        if self.time and self.rate_Hz:
            raise ValueError("expected a column of times or a rate, got both: the times are in the column already")
        if self.point and self.test not in ("", f"point-{self.point}"):
            raise ValueError(f"point {self.point}: expected no test in addition, or point-{self.point}")
        _ = self.choices, self.start_ns, self.span
        return self

    @property
    def test_name(self) -> str:
        """Name of the test in the log."""
        return self.test or (f"point-{self.point}" if self.point else "")

    @property
    def choices(self) -> dict[str, ColumnChoice]:
        """Named columns, by "time", "x", … "speed"."""
        given = {name: getattr(self, name) for name in QUANTITIES}
        return {name: parse_column(text, QUANTITIES[name], name) for name, text in given.items() if text}

    @property
    def span(self) -> TimeSpan:
        """Part of the recording that is imported."""
        return TimeSpan(self.from_s, self.to_s)

    @property
    def start_ns(self) -> int | None:
        """Time 0 of the recording in ns since 1970; None if it is unknown."""
        if self.start is None:
            return None
        try:
            when = datetime.fromisoformat(self.start)
        except ValueError as fault:
            raise ExchangeError(f"start {self.start}: expected a time like 2026-03-01T10:00:00 ({fault})") from fault
        since = (when if when.tzinfo else when.replace(tzinfo=UTC)) - datetime.fromtimestamp(0, UTC)
        nanoseconds = (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
        if not 0 <= nanoseconds < LATEST_NS:
            raise ExchangeError(f"start {self.start}: expected a time from 1970 to 2116")
        return nanoseconds


def make_recipe(**options: object) -> Recipe:
    """Make a recipe from the values of its fields.

    Raises:
        ExchangeError: unknown, invalid or contradictory options; the message contains all of them.
    """
    try:
        return Recipe.model_validate(options)
    except ValidationError as fault:
        lines: list[str] = []
        for error in fault.errors(include_url=False):
            place = ".".join(str(part) for part in error["loc"])
            message = re.sub(r"^Value error, ", "", error["msg"])
            lines.append(f"{place}: {message}" if place else message)
        raise ExchangeError("; ".join(lines)) from fault


def parse_numbers(text: str, field: str) -> tuple[float, ...]:
    """Parse numbers separated by commas.

    Raises:
        ExchangeError: the text contains something else.
    """
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError as fault:
        raise ExchangeError(f"{field} {text}: expected numbers separated by commas") from fault
    if any(math.isinf(number) for number in numbers):
        raise ExchangeError(f"{field} {text}: expected finite numbers")
    return numbers
