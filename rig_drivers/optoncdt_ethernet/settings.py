"""Settings of an optoNCDT 2300 on Ethernet in a rig file."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from daq.drivers.optoncdt.settings import Word
from rig_configs.device import DisplacementSettings
from rig_drivers.optoncdt_ethernet import wire


class EthernetLaser(DisplacementSettings):
    """An optoNCDT 2300 displacement sensor that sends its measured values over TCP.

    The sensor is set up on its web page; the driver sends no command. Its port is `socket://HOST:PORT` of the sensor's
    measuring-value server.

    Attributes:
        rate_Hz: measuring rate to which the sensor is set, Hz.
        words: values of a frame in their order, DIST among them, as set on the sensor's web page.
        scaling: meaning of a distance word: "nm", signed nanometres, for the sensor's own Ethernet output; or the model
            whose formula converts the words of its serial line, if a converter passes these on.
        counts: what the counter of a packet counts. Not verified: the manual does not state it.
    """

    names_its_channel: ClassVar[bool] = True
    serial_limit: ClassVar[int | None] = 2**32

    rate_Hz: Annotated[float, Field(ge=10, le=50_000)] = 5000.0
    words: Annotated[tuple[Word, ...], Field(strict=False, min_length=1, max_length=wire.MOST_FRAME_BYTES // 4)] = (
        "DIST",
    )
    scaling: Literal["nm", "ILD1420", "ILD1900"] = "nm"
    counts: Literal["frames", "packets"] = "frames"

    @field_validator("words")
    @classmethod
    def _has_a_distance(cls, words: tuple[str, ...]) -> tuple[str, ...]:
        if words.count("DIST") != 1 or len({*words}) != len(words):
            raise ValueError(f"expected the values of a frame in their order, each once, DIST among them, got {words}")
        return words
