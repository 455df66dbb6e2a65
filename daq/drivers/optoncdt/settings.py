# pyright: strict
"""Settings of an optoNCDT sensor in a rig file."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from rig_configs.device import DisplacementSettings

_RATES_HZ = (250, 500, 1000, 2000, 4000)


def _measurable(rate_Hz: float) -> float:
    if rate_Hz not in _RATES_HZ:
        raise ValueError(f"expected one of the sensor's rates, {', '.join(map(str, _RATES_HZ))} Hz")
    return rate_Hz


class Laser(DisplacementSettings):
    """An optoNCDT displacement sensor on its serial line.

    scaling is the model by whose formula its distance words are read; without it the name that the sensor gives tells.
    """

    names_its_channel: ClassVar[bool] = True

    baud: Annotated[int, Field(ge=9600, le=1_000_000)] = 921_600
    rate_Hz: Annotated[float, AfterValidator(_measurable)] = 4000.0
    scaling: Literal["ILD1420", "ILD1900"] | None = None
