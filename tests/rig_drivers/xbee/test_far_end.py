"""The simulated node behind its modules: opening dialogue, samples with counted losses, commands and their failures."""

from __future__ import annotations

import queue
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from daq.drivers.rotorlink.far_end import Air
from daq.errors import DeviceError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.lockstep.clock import SimulatedClock
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import DeviceClock
from rig_configs import load_rig
from rig_configs.schema import Radio
from rig_drivers.xbee import framing, wire
from rig_drivers.xbee.driver import DRIVER
from rig_drivers.xbee.far_end import SimulatedXBeeNode
from rig_drivers.xbee.settings import XBeeNode

STEP_S = 0.05

NODE, OWN = "0013A20041AEB54E", "0013A20040522BAA"
KINDS = [
    {"api_mode": 2},
    {"api_mode": 1},
    {"node_address": "12AB"},
    {"legacy_transmit": True},
    {"node_address": "12AB", "legacy_transmit": True, "api_mode": 1},
]
CLEAR_AIR = Radio(burst_start=0.0)


def settings(**changed: Any) -> XBeeNode:
    return XBeeNode.model_validate({"driver": "xbee", "port": "-", "node_address": NODE, **changed})


class Bench:
    """Far end, pipeline and locks on simulated time, in one thread. Also a Talk."""

    def __init__(self, config: XBeeNode, air: Radio = CLEAR_AIR, host: XBeeNode | None = None) -> None:
        rig = load_rig("virtual")
        self.config = host or config
        self.motion = SimulatedMotion(rig.true_physics, 0.0, 0.08)
        self.air = Air(air, np.random.default_rng(3))
        self.far = SimulatedXBeeNode(
            config, self.motion, np.zeros(2), 0.3, 0.0, DeviceClock(5.0, 2e-5), self.air, np.random.default_rng(4)
        )
        self.identity: dict[str, Any] = {}
        self.restart_decoding()
        self.clock = SimulatedClock()
        self.locks = DRIVER.locks(self.config, self.send, self.clock)
        self.raw: list[tuple[int, bytes, int]] = []
        self.found: list[Batch | DeviceEvent] = []
        self.replies: queue.Queue[str] = self.clock.queue()
        self.bytes_in = 0
        self.deaf = False
        self.clock.after(STEP_S, self._step, world=True)

    def restart_decoding(self) -> None:
        self.pipeline = DRIVER.pipeline("encoder", self.config, self.identity)

    def send(self, data: bytes) -> None:
        self._feed(TX, data)
        if not self.deaf:
            self.far.receive(data, self.motion.time_s)

    def _step(self) -> None:
        self.far.step(self.motion.time_s)
        stretch = self.motion.advance(self.clock.now_s())
        assert stretch is not None
        self.far.put_on_air(stretch)
        self._feed(RX, self.far.dongle(self.motion.time_s))
        self.clock.after(STEP_S, self._step, world=True)

    def _feed(self, direction: int, data: bytes) -> None:
        host_ns = self.clock.now_ns()
        self.raw.append((direction, data, host_ns))
        self.bytes_in += len(data) if direction == RX else 0
        for item in self.pipeline.feed(direction, data, host_ns):
            self.found.append(item)
            if isinstance(item, DeviceEvent) and item.kind == "reply":
                self.replies.put(item.text)
            elif isinstance(item, DeviceEvent) and item.kind == "acknowledge":
                self.locks.heard(item)

    def column(self, topic: str, name: str) -> np.ndarray:
        return np.concatenate(
            [i.columns[name] for i in self.found if isinstance(i, Batch) and i.channel.topic == topic] or [np.empty(0)]
        )

    def texts(self, kind: str) -> list[str]:
        return [item.text for item in self.found if isinstance(item, DeviceEvent) and item.kind == kind]


def no_check() -> None:
    """Nothing ends the wait."""


# --- opening ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_the_module_is_identified(kind: dict[str, Any]) -> None:
    bench = Bench(settings(**kind))
    bench.clock.wait(0.2)
    identity = DRIVER.open("encoder", bench.config, bench)
    assert identity == {
        "api_mode": bench.config.api_mode,
        "firmware": "100A",
        "hardware": "2E48",
        "serial": OWN,
        "payload_bytes": 100,
        "rssi_dBm": -58,
    }
    assert DRIVER.pipeline("encoder", bench.config, identity).rssi_dBm == -58
    assert bench.pipeline.losses["damaged_frames"] == 0


@pytest.mark.parametrize("mode", [1, 2])
def test_a_module_in_the_other_mode_is_named(mode: int) -> None:
    bench = Bench(settings(api_mode=3 - mode), host=settings(api_mode=mode))
    bench.clock.wait(1.0)
    with pytest.raises(DeviceError, match=f"in API mode AP={3 - mode}, the rig file states {mode}"):
        DRIVER.open("encoder", bench.config, bench)


def test_the_error_without_an_answer_contains_what_to_check() -> None:
    bench = Bench(settings())
    bench.deaf = True
    with pytest.raises(DeviceError, match=r"no answer to the AT command AP.*baud rate 115200"):
        DRIVER.open("encoder", bench.config, bench)


def test_the_hosts_own_address_is_refused() -> None:
    bench = Bench(settings(node_address=OWN))
    with pytest.raises(DeviceError, match="is that of the module at the host"):
        DRIVER.open("encoder", bench.config, bench)


def test_what_a_module_does_not_know_is_left_out() -> None:
    bench = Bench(settings())
    bench.far._registers = {"AP": b"\x02"}
    known = {"api_mode": 2, "rssi_dBm": -58}
    assert DRIVER.open("encoder", bench.config, bench) == known


def test_answers_to_older_questions_are_passed_over() -> None:
    bench = Bench(settings())
    send = bench.send

    def late(data: bytes) -> None:
        bench.replies.put("9 ZZ 00 ok")
        send(data)

    bench.send = late
    assert DRIVER.open("encoder", bench.config, bench)["serial"] == OWN


# --- samples ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [0x90, 0x91, 0x80])
def test_every_type_of_receive_frame(kind: int) -> None:
    bench = Bench(settings())
    bench.far.receive_type = kind
    bench.clock.wait(0.5)
    assert len(bench.column("pendulums", "index")) >= 90
    assert bench.pipeline.rssi_dBm == (-58 if kind == 0x80 else None)


def test_what_the_air_loses_is_counted_exactly() -> None:
    bench = Bench(settings(rate_Hz=1000), Radio(burst_start=0.05))
    bench.clock.wait(4.0)
    dropped = [number for number in bench.air.dropped if number < bench.air.last_delivered]
    assert len(dropped) > 10
    assert 0 not in dropped
    assert bench.pipeline.losses["radio_frames"] == len(dropped)
    assert bench.pipeline.losses["damaged_frames"] == 0
    index = bench.column("pendulums", "index")
    assert bench.pipeline.losses["samples"] == index[-1] + 1 - len(index)


def test_a_module_that_restarts_is_an_event_and_its_lost_frames_are_counted() -> None:
    bench = Bench(settings(), Radio(burst_start=0.0, delay_s=0.2))
    bench.clock.wait(1.0)
    bench.far.fail("module restart", 1)
    bench.clock.wait(1.0)
    assert len(bench.air.dropped) > 2
    assert bench.pipeline.losses["radio_frames"] == len(bench.air.dropped)
    assert ["watchdog" in text for text in bench.texts("modem")] == [True]
    assert bench.texts("restart") == []  # the node went on


@pytest.mark.parametrize("kind", KINDS)
def test_another_node_in_the_air_adds_nothing(kind: dict[str, Any]) -> None:
    bench = Bench(settings(**kind))
    bench.far.fail("foreign", 5)
    bench.clock.wait(0.5)
    assert len(bench.column("tacho", "revolutions")) == 0
    assert bench.pipeline.losses["foreign_frames"] == 5
    assert len(bench.texts("foreign")) == 1


def test_faults_reach_the_node() -> None:
    bench = Bench(settings())
    bench.far.fail("flags", 1)
    bench.far.fail("marks lost", 1)
    bench.clock.wait(0.5)
    assert np.all(bench.column("pendulums", "flags").astype(int) & 1)
    bench.far.fail("dead", 1)
    seen = len(bench.column("pendulums", "flags"))
    bench.clock.wait(0.5)
    assert len(bench.column("pendulums", "flags")) - seen <= 10
    with pytest.raises(ValueError, match="no fault 'gone'"):
        bench.far.fail("gone", 1)


# --- commands --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_pendulums_are_released_and_locked(kind: dict[str, Any]) -> None:
    bench = Bench(settings(**kind))
    bench.locks.command("release both", no_check)
    bench.clock.wait(0.2)
    assert bench.texts("lock") == ["pendulum A released", "pendulum B released"]
    bench.locks.command("lock both", no_check)
    bench.locks.command("zero", no_check)
    bench.clock.wait(2.0)
    assert bench.texts("lock")[-2:] == ["pendulum A locked", "pendulum B locked"]
    assert bench.texts("acknowledge") == [text for text in bench.texts("acknowledge") if text.endswith("accepted")]


def test_a_refusal_is_the_nodes_word() -> None:
    bench = Bench(settings())
    bench.locks.command("release A", no_check)
    bench.clock.wait(0.2)
    bench.motion.target_rad_s, bench.motion.ramp_rad_s2 = 30.0, 200.0
    bench.clock.wait(1.0)
    with pytest.raises(DeviceError, match="refused: rotor turning"):
        bench.locks.command("lock A", no_check)


@pytest.mark.parametrize(
    ("kind", "words"), [({}, r"network.*0x21"), ({"legacy_transmit": True}, r"no acknowledgement.*0x01")]
)
def test_what_is_not_delivered_is_sent_again_and_then_given_up(kind: dict[str, Any], words: str) -> None:
    bench = Bench(settings(**kind))
    bench.far.fail("out of reach", 1)
    with pytest.raises(
        DeviceError, match=f"'release both' was not delivered.*in 5 tries.*{words}.*Look at the node's power"
    ):
        bench.locks.command("release both", no_check)
    assert sum(direction == TX for direction, _, _ in bench.raw) == 5
    bench.far.fail("out of reach", 0)
    bench.locks.command("release both", no_check)  # the next one is not blamed for it


def test_an_address_of_no_module() -> None:
    bench = Bench(settings(), host=settings(node_address="0013A20011111111"))
    with pytest.raises(DeviceError, match="no module of this address"):
        bench.locks.command("release both", no_check)


def acknowledged(result: int, seq: int) -> DeviceEvent:
    return DeviceEvent("acknowledge", "encoder", f"command {seq}", {"command_seq": seq, "result": result})


def undelivered(frame_id: int) -> DeviceEvent:
    facts = {"frame_id": frame_id, "delivery_status": 0x21}
    return DeviceEvent("acknowledge", "encoder", f"radio frame {frame_id}: no acknowledgement", facts)


def command(answer: Callable[[Any, int, int], None], tries: list[int]) -> None:
    """One command whose requests are answered by `answer(locks, frame id, command seq)`."""

    def send(data: bytes) -> None:
        tries.append(data[4])
        answer(locks, data[4], int.from_bytes(data[19:21], "little"))

    locks = DRIVER.locks(settings(api_mode=1), send, SimulatedClock())
    locks.command("release both", no_check)


def test_the_nodes_acknowledgement_counts_for_any_transmit_status() -> None:
    def answer(locks: Any, frame_id: int, seq: int) -> None:
        locks.heard(undelivered(frame_id))
        locks.heard(acknowledged(0, seq))

    tries: list[int] = []
    command(answer, tries)
    assert tries == [1]


def test_a_frame_that_was_not_delivered_is_sent_again_with_the_same_seq() -> None:
    seqs: list[int] = []

    def answer(locks: Any, frame_id: int, seq: int) -> None:
        seqs.append(seq)
        locks.heard(undelivered(frame_id) if frame_id < 3 else acknowledged(0, seq))

    tries: list[int] = []
    command(answer, tries)
    assert tries == [1, 2, 3]
    assert len(set(seqs)) == 1, "the node acts once"


def test_a_command_is_repeated_with_the_same_seq_and_a_new_frame_id() -> None:
    seqs: list[int] = []

    def answer(locks: Any, frame_id: int, seq: int) -> None:
        seqs.append(seq)
        if len(seqs) == 3:
            locks.heard(acknowledged(0, seq))

    tries: list[int] = []
    command(answer, tries)
    assert tries == [1, 2, 3]
    assert len(set(seqs)) == 1


def test_the_fate_of_older_frames_is_not_blamed_on_a_command() -> None:
    def answer(locks: Any, frame_id: int, seq: int) -> None:
        locks.heard(undelivered(200))
        locks.heard(acknowledged(1, seq ^ 1))
        if frame_id == 2:
            locks.heard(acknowledged(4, seq))

    tries: list[int] = []
    command(answer, tries)
    assert tries == [1, 2]


def test_a_command_is_not_blamed_for_the_one_before() -> None:
    seqs: list[int] = []

    def send(data: bytes) -> None:
        seqs.append(int.from_bytes(data[19:21], "little"))
        if len(seqs) != 2:  # of the second command the first try stays unanswered
            locks.heard(acknowledged(0, seqs[-1]))
        locks.heard(undelivered(1))

    locks = DRIVER.locks(settings(api_mode=1), send, SimulatedClock())
    locks.command("release A", no_check)
    locks._failed = "radio frame 0: long ago"
    locks.command("release B", no_check)
    assert seqs[0] != seqs[1] == seqs[2]


def test_a_node_that_never_answers_is_given_up() -> None:
    tries: list[int] = []
    with pytest.raises(DeviceError, match=r"has not acknowledged .* after 20 tries"):
        command(lambda locks, frame_id, seq: None, tries)
    assert tries == list(range(1, 21))


def test_the_wait_can_be_ended() -> None:
    def end() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        DRIVER.locks(settings(), lambda data: None, SimulatedClock()).command("lock A", end)


def test_frame_ids_wrap_without_zero() -> None:
    bench = Bench(settings())
    bench.locks._frame_id = 254
    for action in ("release A", "release B"):
        bench.locks.command(action, no_check)
    assert bench.locks._frame_id == 1


def test_other_frames_and_damaged_ones_are_ignored() -> None:
    bench = Bench(settings(api_mode=1))
    encode = partial(framing.encode, escaped=False)
    request = wire.transmit_request(0, wire.Address.parse(NODE), b"no RotorLink payload")
    bench.far.receive(encode(b"\x08\x01") + encode(b"\x10\x01") + encode(b"\x2d") + b"garbage" + encode(request), 0.0)
    assert bench.far.dongle(0.0) == b""
