"""Results print as a table of one screen and become a data frame."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rig_basics.errors import RigError
from rig_basics.tabular import Column, Tabular


@dataclass(frozen=True)
class Example(Tabular):
    table: Mapping[str, Column]
    notes: Sequence[str] = field(default_factory=list[str])

    def columns(self) -> Mapping[str, Column]:
        return self.table

    @property
    def remarks(self) -> Sequence[str]:
        return self.notes


def test_a_small_table_is_shown_whole() -> None:
    shown = str(Example({"name": ["a", "long name"], "value_m": np.array([1.23456789, -2e-7])}, ["look at b"]))
    assert shown.splitlines() == [
        "Example",
        "name         value_m",
        "a          1.2345679",
        "long name     -2e-07",
        "- look at b",
    ]


def test_what_does_not_fit_a_screen_is_counted() -> None:
    wide = {f"column_{i}": np.arange(100.0) for i in range(20)}
    lines = str(Example(wide, ["word " * 30] * 40)).splitlines()
    assert "… 10 more columns" in lines
    assert lines[-1] == "… 38 more remarks"
    assert lines[2].split()[0] == "0"
    assert any(line.split()[0] == "99" for line in lines)
    assert any(set(line) <= {"…", " "} for line in lines)


@given(
    rows=st.integers(0, 60),
    columns=st.integers(0, 12),
    notes=st.lists(st.text(st.characters(categories=["L", "Zs"]), max_size=400), max_size=20),
)
def test_a_summary_is_a_screen_at_most(rows: int, columns: int, notes: list[str]) -> None:
    lines = str(Example({f"c{i}": np.arange(rows) for i in range(columns)}, notes)).splitlines()
    assert len(lines) <= 24
    assert all(len(line) <= 100 for line in lines)


def test_the_data_frame_has_every_row() -> None:
    frame = Example({"name": list("abc"), "value_m": np.arange(3.0)}).to_dataframe()
    assert frame["value_m"].tolist() == [0.0, 1.0, 2.0]
    assert frame["name"].tolist() == ["a", "b", "c"]


def test_without_pandas_the_error_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(RigError, match="pip install pandas"):
        Example({"x": [1]}).to_dataframe()
