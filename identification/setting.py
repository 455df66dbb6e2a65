"""Effort of an estimator, and its choice among nested models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Setting = Literal["fast", "balanced", "reference"]
"""fast: least computing time with valid intervals; balanced: close to the bound; reference: as exact as possible."""


@dataclass(frozen=True)
class ModelChoice:
    """One of several nested models of the same record.

    Attributes:
        name: description ("two modes, offset and slope").
        parameters: number of parameters.
        criterion: value by which the models are compared; smaller is better. Each estimator defines its own.
        chosen: whether this is the smallest adequate model.
        why: reason for or against the model.
        missing: terms that the residuals require in addition and that no fit of this package contains.
    """

    name: str
    parameters: int
    criterion: float
    chosen: bool
    why: str
    missing: tuple[str, ...] = ()


def check_setting(setting: str) -> None:
    """Check the name of a setting.

    Raises:
        ValueError: the name is not a setting.
    """
    if setting not in get_args(Setting):
        raise ValueError(f"setting: expected {', '.join(get_args(Setting))}, got {setting!r}")
