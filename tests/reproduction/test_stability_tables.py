"""Tables 3.1 to 3.4: verdicts, cell by cell, and that a wrong cell would show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from reproduction.items import point_sweeps, stability_tables, stable_summary
from tests.reproduction.judged import column, made, verdicts

_C34 = (1e-5, 1e-3, 1e-1)
_ZETAS = (0.005, 0.05, 0.3)


@pytest.fixture(autouse=True)
def few_places(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (point_sweeps, stability_tables, stable_summary):
        monkeypatch.setattr(module, "C34", _C34)
        monkeypatch.setattr(module, "ZETAS", _ZETAS)


def test_type_one(tmp_path: Path) -> None:
    found = made("table-3.1", tmp_path)
    assert verdicts(found) == {
        "Type I, subcritical, properly oversized: it is unstable.": "holds",
        "Type I, supercritical, properly oversized: it is stable.": "holds in part",
        "Outside ABCD Type I does not exist.": "holds",
        "Eigenvalues of the linearised equations describe how a deviation grows.": "holds",
    }
    assert np.array_equal(column(found, "cells", "stable")[:2], [0, 0])
    images = column(found, "cells", "stable")[2:]
    assert images[0] == images[1], "mirror images are alike"


@pytest.mark.parametrize(
    ("number", "part"),
    [
        ("table-3.2", ["Type II, supercritical, improperly oversized: set II is stable, set I unstable."]),
        ("table-3.3", ["Type III, supercritical, undersized: set II is stable, set I unstable."]),
    ],
)
def test_types_two_and_three(number: str, part: list[str], tmp_path: Path) -> None:
    found = made(number, tmp_path)
    judged = verdicts(found)
    assert len(judged) == 6
    assert [statement for statement, verdict in judged.items() if verdict != "holds"] == part
    assert judged[part[0]] == "holds in part"


def test_a_wrong_cell_does_not_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = {cell: (not first, not second) for cell, (first, second) in stability_tables._TABLE_3_1.items()}
    monkeypatch.setattr(stability_tables, "_TABLE_3_1", wrong)
    judged = verdicts(made("table-3.1", tmp_path))
    assert judged["Type I, subcritical, properly oversized: it is stable."] == "does not hold"
    assert judged["Type I, supercritical, properly oversized: it is unstable."] == "does not hold"


def test_the_summary_contradicts_the_tables(tmp_path: Path) -> None:
    found = made("table-3.4", tmp_path)
    judged = verdicts(found)
    assert [s for s, v in judged.items() if v == "does not hold"] == [
        "Below resonance Type II alone is stable.",
        "Above resonance oversized pendulums have Type III stable.",
    ]
    assert sum(v == "holds" for v in judged.values()) == 3, "the subcritical cells"
    assert judged["In each case there is one type of stable singular point."] == "holds in part"
    shares = {kind: column(found, "stable-types", f"{kind}_stable_share") for kind in ("I", "II", "III")}
    assert np.all((shares["I"] > 0).astype(int) + (shares["II"] > 0) + (shares["III"] > 0) == 1)
