"""Result of an item of the source: figures, tables of their data, and a verdict on each claim."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

Verdict = Literal["holds", "holds in part", "does not hold"]
"""Verdict on a claim. For "holds in part", `computed` states how far."""
Column = NDArray[Any] | Sequence[float] | Sequence[str]


@dataclass(frozen=True)
class Claim:
    """A statement of the source that a computation can refute.

    Attributes:
        place: section, figure or table of the statement.
        statement: what is claimed, in our words.
        verdict: result of the computation.
        computed: the numbers that decide, with units.
    """

    place: str
    statement: str
    verdict: Verdict
    computed: str

    @classmethod
    def judged(cls, place: str, statement: str, holds: bool | np.bool_, computed: str) -> Claim:
        """Return a claim that holds or does not."""
        return cls(place, statement, "holds" if holds else "does not hold", computed)

    def to_json(self) -> dict[str, str]:
        """Return the fields by name."""
        return {"place": self.place, "statement": self.statement, "verdict": self.verdict, "computed": self.computed}


@dataclass(frozen=True)
class SourceTable:
    """The data of a figure, or a table of the source.

    Attributes:
        name: letters, digits and "-", unique within an item; the file's name.
        title: what it contains.
        columns: name with unit to values, all of one length.
        shown: whether the book prints it; the file is written in both cases.
    """

    name: str
    title: str
    columns: Mapping[str, Column]
    shown: bool = False


@dataclass(frozen=True)
class Panel:
    """A figure.

    Attributes:
        name: letters, digits and "-", unique within an item; the file's name.
        description: what it shows, in a sentence; read by screen readers and printed below.
        figure: the drawn figure.
    """

    name: str
    description: str
    figure: Figure


@dataclass(frozen=True)
class Reproduced:
    """A reproduced item.

    Attributes:
        panels: figures.
        tables: their data, and tables of the source.
        parameters: parameters of the computation: name with unit to value.
        assumed: choices that the source leaves open, one sentence each.
        claims: at least one.
    """

    panels: tuple[Panel, ...]
    tables: tuple[SourceTable, ...]
    parameters: Mapping[str, float | str]
    assumed: tuple[str, ...]
    claims: tuple[Claim, ...]
