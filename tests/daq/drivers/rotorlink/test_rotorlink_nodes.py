"""Several nodes on air: which one is the rig's, and when the choice is doubtful."""

from __future__ import annotations

import numpy as np

from daq.drivers.rotorlink import wire as rotorlink
from tests.daq.drivers.rotorlink.test_rotorlink_limits import Line, mark


def block(node: int, seq: int) -> bytes:
    """Ten samples; the numbers of a node's blocks continue."""
    counts = np.full((10, 2), node, np.int32)
    return rotorlink.EncoderBlock(node, seq, 10 * seq, 10_000 * seq, 1000, 0, counts).pack()


def status(node: int, seq: int, counts: int = 4096) -> bytes:
    return rotorlink.NodeStatus(node, seq, 10_000 * seq, 3700, 200, seq, 0, 1, 4, counts).pack()


def recorded(line: Line) -> set[int]:
    return set(line.values("count_a"))


def test_the_first_node_that_sends_samples_is_the_rigs() -> None:
    line = Line()
    line.at(0, status(9, 0, counts=1024), status(9, 100, counts=1024))
    assert "1024 counts" in line.pipeline.status.complaint
    assert line.losses == {"radio_frames": 99}
    line.at(9_000, block(1, 0))
    line.at(19_000, block(1, 1), status(9, 7, counts=1024))
    assert recorded(line) == {1}
    assert line.losses == {}
    assert (line.pipeline.status.complaint, line.pipeline.node_status) == ("", None)
    assert line.pipeline.status.learned == {"node": 1}
    assert [event.facts["node"] for event in line.events("acknowledge")] == [9, 1]
    assert [event.facts["node"] for event in line.events("foreign")] == [9]
    line.at(20_000, status(1, 2))
    assert line.pipeline.node_status is not None


def test_two_nodes_that_send_samples_make_the_choice_doubtful() -> None:
    line = Line()
    for k in range(3):
        line.at(10_000 * k + 9_000, block(2, k), block(7, k))
    assert recorded(line) == {2}
    (doubt,) = line.events("doubt")
    assert doubt.text == line.pipeline.status.complaint
    assert doubt.facts == {"node": 7}
    assert all(words in doubt.text for words in ("nodes 2 and 7", "node 2 is decoded", "node = 2"))
    line.at(40_000, status(2, 4, counts=1024))
    assert line.pipeline.status.complaint == doubt.text, "first the node must be known"


def test_a_stated_node_raises_no_doubt() -> None:
    line = Line(node=7)
    for k in range(3):
        line.at(10_000 * k + 9_000, block(2, k), block(7, k))
    assert recorded(line) == {7}
    assert line.events("doubt") == []
    assert line.pipeline.status.complaint == ""
    assert len(line.events("foreign")) == 1


def test_a_log_s_node_stays_that_of_the_log() -> None:
    line = Line({"node": 7})
    line.at(9_000, block(2, 0), block(2, 1))
    line.at(19_000, block(7, 1))
    assert recorded(line) == {7}
    assert line.pipeline.status.learned == {"node": 7}


def test_other_nodes_without_samples_raise_no_doubt() -> None:
    line = Line()
    line.at(9_000, block(1, 0), status(9, 0), mark(1, 9_000, node=9))
    assert line.pipeline.status.complaint == ""
    assert [event.facts["node"] for event in line.events("foreign")] == [9]


def test_a_span_that_is_not_known_is_not_stated() -> None:
    line = Line()
    line.at(9_000, block(1, 0))
    line.at(19_000, rotorlink.encode_frame(bytes((0x1F, 1, 3, 0, 9))))  # of an unknown kind, without a time
    assert [event.text for event in line.events("gap")] == ["2 radio frames lost"]
    assert line.events("gap")[0].facts["span_s"] == 0.0
