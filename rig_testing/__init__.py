"""The tests that every driver must pass, run on simulated time with the driver's own far end.

`examine(driver)` runs all and returns a report. A driver's own package runs the same one by one in its pytest:

    import pytest, rig_testing
    from my_driver import DRIVER

    @pytest.mark.parametrize("case", rig_testing.cases(DRIVER), ids=str)
    def test_contract(case):
        case()

A test depends on the contract (`daq.drivers.contract`) and on no device. A test that does not apply is skipped, with a
reason.
"""

import logging

from rig_testing.examination import ContractCase, cases, examine
from rig_testing.report import CaseOutcome, DriverReport, Failed, NotTried

__all__ = ["CaseOutcome", "ContractCase", "DriverReport", "Failed", "NotTried", "cases", "examine"]
logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until the program shows its log
