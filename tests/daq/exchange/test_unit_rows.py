"""Lines of units are recognised in any notation, above or below the names, and are compared with the options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq.exchange import ExchangeError
from daq.exchange.csv_dialect import sniff
from daq.exchange.units import is_unit_row, name_and_unit, unit_word
from tests.daq.exchange.test_import import bring_in, text
from tests.effort import cases

T = np.arange(60) * 0.5
X = 2 * np.cos(0.3 * T)
ANGLE = 100 + 5 * T
NAMES = ["Zeit", "Weg x", "Weg y", "A", "B", "Drehzahl"]
FILE_UNITS = ["ms", "mm", "mm", "deg", "deg", "rpm"]


def table(delimiter: str, decimal: str = ".") -> str:
    rows = np.column_stack([T, X, -X, ANGLE, ANGLE + 180, 300 + T])
    return "".join(delimiter.join(f"{v:.6f}".replace(".", decimal) for v in row) + "\n" for row in rows)


HEADS = {
    "as in the issue": ("Zeit;Weg x;Weg y;A;B;Drehzahl\nms;mm;mm;°;°;1/min\n", ";"),
    "above the names": ("ms;mm;mm;°;°;1/min\nZeit;Weg x;Weg y;A;B;Drehzahl\n", ";"),
    "in brackets": ("Zeit,Weg x,Weg y,A,B,Drehzahl\n[ms],[mm],[mm],[°],[°],[rpm]\n", ","),
    "in parentheses": ("Zeit;Weg x;Weg y;A;B;Drehzahl\n(ms);(mm);(mm);(deg);(deg);(U/min)\n", ";"),
    "tabs": ("Zeit\tWeg x\tWeg y\tA\tB\tDrehzahl\nms\tmm\tmm\tdeg\tdeg\tmin-1\n", "\t"),
    "quoted": ('"Zeit";"Weg x";"Weg y";"A";"B";"Drehzahl"\n"ms";"mm";"mm";"°";"°";"min^-1"\n', ";"),
    "as a remark": ("Zeit;Weg x;Weg y;A;B;Drehzahl\n# ms;mm;mm;°;°;1/min\n", ";"),
    "both remarks": ("# by hand\n# Zeit;Weg x;Weg y;A;B;Drehzahl\n# [ms];[mm];[mm];[°];[°];[1/min]\n", ";"),
    "under a title": ("Prüfstand 7\n\nZeit;Weg x;Weg y;A;B;Drehzahl\n\nms;mm;mm;°;°;1/min\n\n", ";"),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("head", HEADS.values(), ids=HEADS)
def test_units_are_distinguished_from_names(tmp_path: Path, head: tuple[str, str], decimal: str, encoding: str) -> None:
    lines, delimiter = head
    if delimiter == "," and decimal == ",":
        return
    found = sniff(text(tmp_path / "a.csv", lines + table(delimiter, decimal), encoding))
    assert list(found.names) == NAMES
    assert dict(found.units) == dict(zip(NAMES, FILE_UNITS, strict=True))
    assert found.decimal == decimal


def test_units_alone_are_units_and_names(tmp_path: Path) -> None:
    path = text(tmp_path / "a.csv", "ms;mm;mm;°;°;1/min\n" + table(";"))
    found = sniff(path)
    assert found.names[0] == "ms"
    assert list(found.units.values()) == FILE_UNITS
    run = bring_in(path, time="1", x="2", y="3", theta3="4", theta4="5", test="t")
    assert np.allclose(run.x_m, 1e-3 * np.round(X, 6))
    assert np.allclose(np.diff(run.x_time_s), 0.5e-3, atol=1e-9)
    assert np.allclose(run.angle_rad[:, 0], np.radians(ANGLE))


@pytest.mark.parametrize("unit", ["-", "1", ""])
def test_a_column_without_unit_does_not_make_it_a_row_of_numbers(tmp_path: Path, unit: str) -> None:
    path = text(
        tmp_path / "a.csv", f"t;x;n\ns;mm;{unit}\n" + "".join(f"{t};{x:.5f};3\n" for t, x in zip(T, X, strict=True))
    )
    assert dict(sniff(path).units) == {"t": "s", "x": "mm"}
    assert sniff(path).names == ("t", "x", "n")


@pytest.mark.parametrize(
    "header", ["t [s];x [mm]", "t (s);x (mm)", "t / s;x / mm", "t in s;x in mm", "t [sec];x [millimeter]"]
)
def test_names_that_carry_their_unit_may_be_given_with_or_without_it(tmp_path: Path, header: str) -> None:
    path = text(tmp_path / "a.csv", header + "\n" + "".join(f"{t};{x:.5f}\n" for t, x in zip(T, X, strict=True)))
    one, two = header.split(";")
    for options in ({"time": "t", "x": "x"}, {"time": one, "x": two}, {"time": "t:s", "x": "x:mm"}):
        assert np.allclose(bring_in(path, **options).x_m, 1e-3 * np.round(X, 5))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"x": "Weg x:um"}, r"x Weg x:um: expected the unit that the file gives the column, 'mm', got 'um'"),
        ({"time": "Zeit:s"}, "expected the unit that the file gives the column, 'ms'"),
        ({"x": "A"}, "expected a column of length .* the file gives its unit as 'deg'"),
        ({"theta3": "Weg x:deg"}, "expected a column of angle"),
    ],
)
def test_another_unit_than_the_file_s_is_refused(tmp_path: Path, options: dict[str, Any], words: str) -> None:
    path = text(tmp_path / "a.csv", HEADS["as in the issue"][0] + table(";"))
    with pytest.raises(ExchangeError, match=words):
        bring_in(path, **({"time": "Zeit", "x": "Weg x"} | options))
    run = bring_in(path, time="Zeit:ms", x="Weg x:-mm")  # the sign and a scale are given by the operator
    assert np.allclose(run.x_m, -1e-3 * np.round(X, 6))
    assert np.allclose(bring_in(path, time="Zeit", x="Weg x:0.002").x_m, 2e-3 * np.round(X, 6))


def test_words_for_units() -> None:
    for cell, unit in {
        "µm": "um",
        "μm": "um",
        "Âµm": "um",
        "[°]": "deg",
        "(1/min)": "rpm",
        "min⁻¹": "rpm",
        "º": "deg",
        "Sekunden": "s",
        "RPM": "rpm",
        "hz": "Hz",
        "rad/s": "rad/s",
        "MM": "mm",
    }.items():
        assert unit_word(cell) == unit, cell
    assert not is_unit_row(["t", "x"])
    assert not is_unit_row(["-", "1"])
    assert not is_unit_row(["x", "mm"])
    assert is_unit_row(["V", "s", "°C", ""])
    assert name_and_unit("x (left)") == ("x (left)", None)
    assert name_and_unit("speed [1/min]") == ("speed", "rpm")


@settings(max_examples=cases(20, 60), deadline=None)
@given(cells=st.lists(st.text(max_size=8), min_size=1, max_size=5))
def test_any_cells_are_a_unit_row_or_none(cells: list[str]) -> None:
    if is_unit_row(cells):
        assert any(unit_word(cell) for cell in cells)
