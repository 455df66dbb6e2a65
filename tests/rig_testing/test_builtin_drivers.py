"""Every driver that is installed passes the kit that strangers run on theirs."""

from __future__ import annotations

import pytest

import rig_testing
from daq.drivers.registry import driver
from rig_configs.drivers import installed


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, id=f"{name}-{case}") for name in installed() for case in rig_testing.cases(driver(name))],
)
def test_contract(case: rig_testing.ContractCase) -> None:
    case()


def test_a_run_is_repeatable() -> None:
    from rig_testing.subject import Subject

    first, second = (Subject(driver("vesc"), thorough=False).tape for _ in range(2))
    assert first.reads == second.reads
