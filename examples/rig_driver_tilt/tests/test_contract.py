"""The driver passes the tests that every driver must pass."""

import pytest
from rig_driver_tilt import DRIVER

import rig_testing


@pytest.mark.parametrize("case", rig_testing.cases(DRIVER), ids=str)
def test_contract(case: rig_testing.ContractCase) -> None:
    case()
