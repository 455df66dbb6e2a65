"""What the settings of drivers are, made from their models; each states what it means."""

from __future__ import annotations

from typing import Annotated, Literal

import pytest
from pydantic import Field

from rig_configs.drivers import installed, settings_of
from rig_configs.setting_rows import COMMON, SettingRow, rows_of, tables_inside
from rig_configs.table import RigTable


class Gauge(RigTable):
    """A gauge.

    Attributes:
        low, high: ends of its range, V; "|" is text.
        first, second, third: gains.
        edge: "rising" or "falling".
    """

    low: Annotated[float, Field(ge=-10)] = 0.0
    high: Annotated[float, Field(ge=-10)] = 5.0
    first: float = 1.0
    second: float = 2.0
    third: float = 1.0
    edge: Literal["rising", "falling"]


class Panel(RigTable):
    """A panel.

    Attributes:
        left, right: its gauges.
        count: number of lamps; None: unknown.
    """

    left: Gauge
    right: Gauge
    count: Annotated[int, Field(gt=0)] | None = None


def test_names_of_one_meaning_share_a_row() -> None:
    assert rows_of(Gauge) == [
        SettingRow(("low", "high"), "0.0, 5.0", "≥ -10", 'ends of its range, V; "|" is text.'),
        SettingRow(("first", "second", "third"), "1.0, 2.0, 1.0", "number", "gains."),
        SettingRow(("edge",), "required", '"rising", "falling"', '"rising" or "falling".'),
    ]
    assert rows_of(Gauge, Gauge.model_fields) == []


def test_tables_inside_stand_once() -> None:
    assert [row.permitted for row in rows_of(Panel)] == ["table", "whole number > 0"]
    assert tables_inside(Panel) == {"Gauge": rows_of(Gauge)}


@pytest.mark.parametrize("model", [*map(settings_of, installed()), *COMMON.values()], ids=lambda model: model.__name__)
def test_every_setting_of_a_driver_states_what_it_means(model: type[RigTable]) -> None:
    assert {name for row in rows_of(model) for name in row.names} == set(model.model_fields)
    assert all(row.meaning for rows in (rows_of(model), *tables_inside(model).values()) for row in rows)
