"""How a file recorded elsewhere is to be read: which column is what, in which unit, and what the test was."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from daq.exchange.errors import ExchangeError
from daq.exchange.units import ColumnChoice, Quantity, parse_column

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


class Recipe(BaseModel):
    """Every option of an import. Columns are written ``NAME:UNIT``, see daq.exchange.units.parse_column.

    Attributes:
        test: "ring-down-x", "ring-down-y", "spin-down", "run-up", "run-down", "point-NAME" or a name of one's own.
        point: name of a validation point; the test is "point-NAME" where none is given.
        note: the operator's words.
        time: column of the sample times; or else rate_Hz, the rate of the rows.
        x, y: displacements of the disk's centre.
        theta3, theta4: pendulum angles relative to the rotor.
        phase: rotor angle ψ in every row; or marks: the times at which the index mark passed, as a column or a file
            of its own; or speed, which is integrated.
        start: what time 0 of the recording was, ISO 8601, UTC where it names no zone.
        release_s: when pendulum A and B were let go, in seconds of the recording's time; one number stands for both.
        counts_per_revolution: of the encoders, where it is not the rig file's.
        invalid: numbers that stand for "no reading", as they are in the file.
        clock_tolerance_ppm: standard uncertainty of the rate of the recording's clock; None: the rig file's where it
            says one, otherwise 50 ppm.
        recorder: name of the recorder; recordings of one recorder share its clock's error. Those without a name count
            as one recorder's.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    test: str = ""
    point: str = ""
    note: str = ""
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

    @model_validator(mode="after")
    def _fits_together(self) -> Recipe:
        if not self.test_name:
            raise ValueError("--test: expected the test's name, such as ring-down-x, or --point NAME")
        if not any(getattr(self, name) for name in _SENSORS):
            raise ValueError(f"expected at least one of --{', --'.join(_SENSORS)}")
        rotor = [f"--{name}" for name in _ROTOR if getattr(self, name)]
        if len(rotor) > 1:
            raise ValueError(f"expected one of --phase, --marks and --speed, got {' and '.join(rotor)}")
        if self.time and self.rate_Hz:
            raise ValueError("expected --time or --rate, got both: the times are in the column already")
        if self.point and self.test not in ("", f"point-{self.point}"):
            raise ValueError(f"--point {self.point}: expected no --test beside it, or point-{self.point}")
        _ = self.choices, self.start_ns
        return self

    @property
    def test_name(self) -> str:
        """The test as the log names it."""
        return self.test or (f"point-{self.point}" if self.point else "")

    @property
    def choices(self) -> dict[str, ColumnChoice]:
        """What was named, by "time", "x", … "speed"."""
        given = {name: getattr(self, name) for name in QUANTITIES}
        return {name: parse_column(text, QUANTITIES[name], f"--{name}") for name, text in given.items() if text}

    @property
    def start_ns(self) -> int | None:
        """Time 0 of the recording in ns since 1970; None when it is not known."""
        if self.start is None:
            return None
        try:
            when = datetime.fromisoformat(self.start)
        except ValueError as fault:
            raise ExchangeError(f"--start {self.start}: expected a time like 2026-03-01T10:00:00 ({fault})") from fault
        since = (when if when.tzinfo else when.replace(tzinfo=UTC)) - datetime.fromtimestamp(0, UTC)
        nanoseconds = (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
        if nanoseconds < 0:
            raise ExchangeError(f"--start {self.start}: expected a time after 1970")
        return nanoseconds


def make_recipe(**options: object) -> Recipe:
    """A recipe of options as the command line names them.

    Raises:
        ExchangeError: options that are unknown, out of range or do not fit together; all of them in the message.
    """
    try:
        return Recipe.model_validate(options)
    except ValidationError as fault:
        lines = []
        for error in fault.errors(include_url=False):
            place = ".".join(str(part) for part in error["loc"])
            message = re.sub(r"^Value error, ", "", error["msg"])
            lines.append(f"--{place.replace('_', '-')}: {message}" if place else message)
        raise ExchangeError("; ".join(lines)) from fault


def parse_numbers(text: str, option: str) -> tuple[float, ...]:
    """Numbers separated by commas.

    Raises:
        ExchangeError: something else.
    """
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError as fault:
        raise ExchangeError(f"{option} {text}: expected numbers separated by commas") from fault
    if any(math.isinf(number) for number in numbers):
        raise ExchangeError(f"{option} {text}: expected finite numbers")
    return numbers
