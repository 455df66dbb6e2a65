# pyright: strict
"""What an item of the source comes to: figures, tables of their data, and a verdict on each claim."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

Verdict = Literal["holds", "holds in part", "does not hold"]
"""Of a claim. "in part": as far as `computed` says."""
Column = NDArray[Any] | Sequence[float] | Sequence[str]


@dataclass(frozen=True)
class Claim:
    """A statement of the source that a computation can refute.

    Attributes:
        place: section, figure or table where it stands.
        statement: what is claimed, in our words.
        verdict: what the computation makes of it.
        computed: the numbers that decide, with units.
    """

    place: str
    statement: str
    verdict: Verdict
    computed: str

    @classmethod
    def judged(cls, place: str, statement: str, holds: bool | np.bool_, computed: str) -> Claim:
        """A claim that holds or does not."""
        return cls(place, statement, "holds" if holds else "does not hold", computed)

    def to_json(self) -> dict[str, str]:
        """Fields by name."""
        return {"place": self.place, "statement": self.statement, "verdict": self.verdict, "computed": self.computed}


@dataclass(frozen=True)
class Table:
    """The numbers behind a figure, or a table of the source.

    Attributes:
        name: letters, digits and "-", different within an item; the file's name.
        title: what it holds.
        columns: name with unit to values, all of one length.
        shown: whether the book prints it; the file is written either way.
    """

    name: str
    title: str
    columns: Mapping[str, Column]
    shown: bool = False


@dataclass(frozen=True)
class Panel:
    """A figure.

    Attributes:
        name: letters, digits and "-", different within an item; the file's name.
        description: what is to be seen, in a sentence; read out by screen readers and printed below.
        figure: drawn.
    """

    name: str
    description: str
    figure: Figure


@dataclass(frozen=True)
class Reproduced:
    """An item made anew.

    Attributes:
        panels: figures.
        tables: their data, and tables of the source.
        parameters: what was computed with: name with unit to value.
        assumed: what the source leaves open and was chosen here, a sentence each.
        claims: at least one.
    """

    panels: tuple[Panel, ...]
    tables: tuple[Table, ...]
    parameters: Mapping[str, float | str]
    assumed: tuple[str, ...]
    claims: tuple[Claim, ...]
