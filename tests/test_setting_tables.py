"""The tables of settings in the docs are made from the models, and each setting states what it means."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Annotated, Literal

import pytest
from pydantic import Field

from rig_configs.drivers import installed
from rig_configs.table import RigTable

SOURCE = Path(__file__).parents[1] / "docs" / "_ext" / "setting_tables.py"


@pytest.fixture(scope="module")
def made() -> ModuleType:
    spec = importlib.util.spec_from_file_location("setting_tables", SOURCE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Gauge(RigTable):
    """A gauge.

    Attributes:
        low, high: ends of its range, V; "|" is text.
        edge: "rising" or "falling".
    """

    low: Annotated[float, Field(ge=-10)] = 0.0
    high: Annotated[float, Field(ge=-10)] = 5.0
    edge: Literal["rising", "falling"]


class Undocumented(Gauge):
    """It has a setting more."""

    secret: int = 0


def test_names_of_one_meaning_share_a_row(made: ModuleType) -> None:
    assert made.table(Gauge)[3:] == [
        '| `low`, `high` | `0.0`, `5.0` | ≥ -10 | ends of its range, V; "\\|" is text. |',
        '| `edge` | required | `"rising"`, `"falling"` | "rising" or "falling". |',
    ]
    assert made.table(Gauge, ["low", "high", "edge"]) == []


def test_a_setting_without_a_meaning_is_refused(made: ModuleType) -> None:
    with pytest.raises(LookupError, match="Undocumented does not state what secret means"):
        made.table(Undocumented)


def test_every_driver_has_its_tables(made: ModuleType) -> None:
    page = made.all_tables()
    assert all(f"\n## `{driver}`\n" in page for driver in installed())
    assert "| `least_delay_s` | `0.0` | ≥ 0 ≤ 1 |" in page
    assert page.count('| `serial` | `""` |') == 1, "common settings stand once"
