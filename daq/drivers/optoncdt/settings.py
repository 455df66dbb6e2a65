# pyright: strict
"""Settings of an optoNCDT sensor in a rig file."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rig_configs.device import DisplacementSettings


class Laser(DisplacementSettings):
    """An optoNCDT displacement sensor on its serial line.

    rate_Hz is one that its model has, 250, 500, 1000, 2000 or 4000 for an ILD1420; another is refused by the sensor.
    scaling is the model by whose formula its distance words are read; without it the name that the sensor gives tells.
    """

    names_its_channel: ClassVar[bool] = True

    baud: Annotated[int, Field(ge=9600, le=1_000_000)] = 921_600
    rate_Hz: Annotated[float, Field(ge=10, le=50_000)] = 4000.0
    scaling: Literal["ILD1420", "ILD1900"] | None = None
