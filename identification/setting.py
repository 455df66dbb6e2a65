"""How much an estimator may cost, and which model it found to be enough."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Setting = Literal["fast", "balanced", "reference"]
"""fast: cheapest with honest intervals; balanced: near the bound; reference: as exact as the data allow."""


@dataclass(frozen=True)
class ModelChoice:
    """One of several nested models of the same record.

    Attributes:
        name: in words ("two modes, offset and slope").
        parameters: how many.
        criterion: the value by which models are compared, smaller is better; how it is made is told by the room.
        chosen: this is the smallest adequate one.
        why: what decided for or against it.
    """

    name: str
    parameters: int
    criterion: float
    chosen: bool
    why: str


def check_setting(setting: str) -> None:
    """Whether there is such a setting.

    Raises:
        ValueError: there is not.
    """
    if setting not in get_args(Setting):
        raise ValueError(f"setting: expected {', '.join(get_args(Setting))}, got {setting!r}")
