"""Settings of an optoNCDT sensor in a rig file."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from rig_configs.device import DisplacementSettings

_TIMESTAMP = ("TIMESTAMP_LO", "TIMESTAMP_HI")

Word = Annotated[str, Field(strict=True, pattern=r"^[A-Z0-9_]{1,40}$")]


def _halves(words: tuple[str, ...]) -> tuple[str, ...]:
    """Return the values of a block; a timestamp consists of two values, low half first."""
    return tuple(each for word in words for each in (_TIMESTAMP if word == "TIMESTAMP" else (word,)))


class Laser(DisplacementSettings):
    """An optoNCDT displacement sensor on its serial line.

    Attributes:
        baud: line rate of the sensor, baud.
        rate_Hz: measuring rate, Hz; one of those of the model (250, 500, 1000, 2000 or 4000 for an ILD1420). The sensor
            refuses any other rate.
        scaling: model whose formula converts the distance words; by default that of the model the sensor reports.
            "ILD1420 mastered": the sensor keeps a zero that was set in it.
        words: outputs in stream order, including DIST, COUNTER and TIMESTAMP; by default the sensor is queried.
    """

    names_its_channel: ClassVar[bool] = True

    baud: Annotated[int, Field(ge=9600, le=1_000_000)] = 921_600
    rate_Hz: Annotated[float, Field(ge=10, le=50_000)] = 4000.0
    scaling: Literal["ILD1420", "ILD1420 mastered", "ILD1900"] | None = None
    words: Annotated[tuple[Word, ...], Field(strict=False, max_length=31)] = ()

    @property
    def output_words(self) -> tuple[str, ...]:
        """Names of a block's values, as in the identity; empty if the sensor is to be queried."""
        return _halves(self.words)

    @field_validator("words")
    @classmethod
    def _give_samples(cls, words: tuple[str, ...]) -> tuple[str, ...]:
        values = _halves(words)
        if words and (len({*values}) != len(values) or not {"DIST", "COUNTER", *_TIMESTAMP} <= {*values}):
            raise ValueError(
                f"expected the outputs in stream order, each once, DIST, COUNTER and TIMESTAMP among them, got {words}"
            )
        return words
