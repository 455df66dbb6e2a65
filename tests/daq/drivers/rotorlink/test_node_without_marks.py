"""A node on the rotor whose index marks are not the rig's rotor phase: no role, no channel, no samples."""

from __future__ import annotations

import pytest

from daq.channels import PENDULUMS, TACHO
from daq.drivers.rotorlink import wire
from daq.drivers.rotorlink.driver import DRIVER
from daq.drivers.rotorlink.settings import EncoderNode
from daq.items import RX, Batch
from rig_configs.roles import RotorPhase

MARK = wire.wire(wire.IndexMark(1, 10, 2_050_000, 33).pack())


def node(index_marks: bool) -> EncoderNode:
    return EncoderNode.model_validate({"driver": "rotorlink", "port": "p", "index_marks": index_marks})


@pytest.mark.parametrize("index_marks", [True, False])
def test_marks_have_a_role_and_a_channel_only_if_they_are_used(index_marks: bool) -> None:
    settings = node(index_marks)
    assert any(isinstance(role, RotorPhase) for role in settings.roles("node")) == index_marks
    assert DRIVER.occasional(settings) == ((TACHO,) if index_marks else ())
    assert DRIVER.channels(settings) == (PENDULUMS,)
    found = DRIVER.pipeline("node", settings, {}).feed(RX, MARK, 1_700_000_000_000_000_000)
    assert [item.channel for item in found if isinstance(item, Batch)] == ([TACHO] if index_marks else [])
