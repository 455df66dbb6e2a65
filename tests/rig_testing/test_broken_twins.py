"""Every test of the kit is seen red: a driver that is broken in one way fails that test, for that reason."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ConfigDict

import rig_testing
from daq import channels
from daq.drivers.cia402.control import DriveControl
from daq.drivers.cia402.driver import DRIVER as CIA402
from daq.drivers.contract import RotorGuard
from daq.drivers.driver import Driver
from daq.drivers.optoncdt.driver import DRIVER as OPTONCDT
from daq.drivers.played import PlayedDevice
from daq.drivers.rotorlink.driver import DRIVER as ROTORLINK
from daq.drivers.rotorlink.locks import NodeLocks
from daq.drivers.rotorlink.settings import EncoderNode
from daq.items import RX, Batch, DeviceEvent
from rig_drivers.vesc.control import VescControl
from rig_drivers.vesc.driver import DRIVER as VESC
from rig_drivers.vesc.far_end import SimulatedVesc
from rig_testing.examination import CHECKS

Items = list[Batch | DeviceEvent]


def with_pipeline(driver: Driver, feed: Callable[..., Items], claims: frozenset[str] | None = None) -> Driver:
    """A driver whose pipeline's `feed` is another: called with the pipeline, the sound feed and a read."""

    def pipeline(device: str, settings: Any, identity: Mapping[str, Any]) -> Any:
        sound = driver.pipeline(device, settings, identity)
        given = sound.feed
        sound.feed = lambda direction, data, host_ns: feed(sound, given, direction, data, host_ns)
        return sound

    return replace(driver, pipeline=pipeline, claims=driver.claims if claims is None else claims)


def on_batches(change: Callable[[Batch], Batch | None]) -> Callable[..., Items]:
    """Every batch changed, or dropped."""

    def feed(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
        out: Items = []
        for item in given(direction, data, host_ns):
            changed = change(item) if isinstance(item, Batch) else item
            out += [] if changed is None else [changed]
        return out

    return feed


def column(name: str, change: Callable[[Any], Any]) -> Callable[[Batch], Batch]:
    def changed(batch: Batch) -> Batch:
        if name not in batch.columns:
            return batch
        return replace(batch, columns={**batch.columns, name: change(batch.columns[name])})

    return changed


# --- what is broken in the device's own part -----------------------------------------------------------------------


class LaxNode(EncoderNode):
    model_config = ConfigDict(extra="ignore")


class AstrayNode(EncoderNode):
    def roles(self, device: str) -> Any:
        return super().roles("encoder")


def sleeps(device: str, settings: Any, talk: Any) -> dict[str, Any]:
    time.sleep(0.001)
    return ROTORLINK.open(device, settings, talk)


def stop_raises(settings: Any, talk: Any) -> None:
    raise RuntimeError("no such command")


def stops_for_ever(settings: Any, talk: Any) -> None:
    talk.send(b"BAUDRATE 9600\nOUTPUT NONE\n")
    talk.gone = True


def stop_of_a_lost_link_raises(settings: Any, talk: Any) -> None:
    try:
        OPTONCDT.stop(settings, talk)
    except Exception as error:
        raise OSError("write failed") from error


def takes_silence_for_off(settings: Any, send: Any, clock: Any, guard: RotorGuard) -> Any:
    """`disable` does not check that the controller answers."""
    control = VescControl(settings, send, clock, guard)
    control._switch_off = lambda: ""
    return control


def requests_no_permission(settings: Any, send: Any, clock: Any, guard: RotorGuard) -> Any:
    return DriveControl(settings, send, clock, replace(guard, permit=lambda rpm: None))


def locks_only_acknowledge(settings: Any, send: Any, clock: Any) -> Any:
    class Idle(NodeLocks):
        def command(self, action: str, check: Callable[[], None]) -> None:
            check()
            send(b"")

    return Idle(send, clock)


STOP_RAISES = replace(ROTORLINK, stop=stop_raises)


# --- what is broken in its pipeline ----------------------------------------------------------------------------


def drops_a_sample(batch: Batch) -> Batch:
    if batch.channel.topic != "pendulums" or int(batch.sequence[0]) % 1000:
        return batch
    return replace(
        batch,
        time_ns=batch.time_ns[1:],
        sequence=batch.sequence[1:],
        columns={name: values[1:] for name, values in batch.columns.items()},
    )


def drops_short_reads(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
    return given(direction, data, host_ns) if direction != RX or len(data) > 2 else []


def shares_a_count(seen: list[int]) -> Callable[..., Items]:
    def feed(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
        seen.append(0)
        return [
            replace(item, sequence=item.sequence + np.uint32(len(seen))) if isinstance(item, Batch) else item
            for item in given(direction, data, host_ns)
        ]

    return feed


def crashes_on_damage(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
    out = given(direction, data, host_ns)
    if any(isinstance(item, DeviceEvent) and item.kind == "damage" for item in out):
        raise KeyError("unknown frame")
    return out


def drops_losses(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
    out = given(direction, data, host_ns)
    pipeline.losses = dict.fromkeys(pipeline.losses, 0)
    return out


def waits_after_a_late_read(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
    """Samples wait for a second after a read that came late, whether the log ends or not."""
    waiting, newest_ns, until_ns = getattr(pipeline, "state", ([], host_ns, 0))
    waiting += given(direction, data, host_ns)
    until_ns = host_ns + 10**9 if host_ns - newest_ns > 40_000_000 else until_ns
    pipeline.state = ([], host_ns, until_ns) if host_ns > until_ns else (waiting, host_ns, until_ns)
    return waiting if host_ns > until_ns else []


def gives_twice(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
    """Every end of a log gives the last samples."""
    if data:
        pipeline.newest = given(direction, data, host_ns)
    return pipeline.newest


def miscounts(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
    before = pipeline.losses["samples"]
    out = given(direction, data, host_ns)
    pipeline.losses["samples"] += pipeline.losses["samples"] > before
    return out


def keeps_quiet(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
    return [item for item in given(direction, data, host_ns) if isinstance(item, Batch) or item.kind == "reply"]


def ends_at_a_restart(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
    if getattr(pipeline, "ended", False):
        return []
    out = given(direction, data, host_ns)
    pipeline.ended = any(isinstance(item, DeviceEvent) and item.kind == "restart" for item in out)
    return out


def restarts_at_a_wrap(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
    out = given(direction, data, host_ns)
    for item in list(out):
        if isinstance(item, Batch):
            last, pipeline.newest = getattr(pipeline, "newest", 0), int(item.sequence[-1])
            if pipeline.newest < last:
                out.append(DeviceEvent("restart", "device", "its counter restarted"))
    return out


def hoards(pipeline: Any, given: Any, direction: int, data: bytes, host_ns: int) -> Items:
    pipeline.hoard = getattr(pipeline, "hoard", b"") + data
    return given(direction, data, host_ns)


BROKEN: dict[str, tuple[str, Driver, str]] = {
    "an invalid example": ("settings", replace(VESC, example={"pole_pairs": 7}), "timeout_s"),
    "settings that take any key": ("settings", replace(ROTORLINK, settings=LaxNode), "unknown key"),
    "an unknown claim": ("settings", replace(ROTORLINK, claims=frozenset({"never wrong"})), "never wrong"),
    "a channel without a role": (
        "roles",
        replace(ROTORLINK, occasional=lambda settings: (channels.TACHO, channels.MOTOR)),
        "expected the same",
    ),
    "a role of another device": ("roles", replace(ROTORLINK, settings=AstrayNode), "'encoder', expected 'device'"),
    "an identity of arrays": (
        "opening dialogue",
        replace(ROTORLINK, open=lambda *_: {"serial": np.arange(3)}),
        "not JSON",
    ),
    "an identity that JSON changes": (
        "opening dialogue",
        replace(ROTORLINK, open=lambda *_: {"words": (1, 2)}),
        "through JSON",
    ),
    "a wait without a timeout": (
        "silent device",
        replace(ROTORLINK, open=lambda device, settings, talk: {"reply": talk.replies.get()}),
        "without a timeout",
    ),
    "a wait without its clock": ("waits", replace(ROTORLINK, open=sleeps), "time.sleep at test_broken_twins.py"),
    "a sample dropped in silence": (
        "stream",
        with_pipeline(ROTORLINK, on_batches(drops_a_sample)),
        "no loss was counted",
    ),
    "times of the device's own clock": (
        "stream",
        with_pipeline(ROTORLINK, on_batches(lambda b: replace(b, time_ns=b.time_ns - 10**12))),
        "away from the host's",
    ),
    "the wrong sign": (
        "displacement",
        with_pipeline(OPTONCDT, on_batches(column("displacement_m", np.negative))),
        "sign",
    ),
    "degrees in place of radians": (
        "pendulum angles",
        with_pipeline(ROTORLINK, on_batches(column("theta3_rad", np.degrees))),
        "57.",
    ),
    "every other mark": (
        "rotor phase",
        with_pipeline(
            ROTORLINK,
            on_batches(lambda b: None if b.channel.topic == "tacho" and int(b.columns["revolutions"][0]) % 2 else b),
        ),
        "marks in",
    ),
    "electrical speed": (
        "speed",
        with_pipeline(VESC, on_batches(column("speed_rpm", lambda v: 7 * v))),
        "rpm off",
    ),
    "state that pipelines share": (
        "replay",
        with_pipeline(ROTORLINK, shares_a_count([])),
        "differs in sequence",
    ),
    "short reads dropped": ("split", with_pipeline(ROTORLINK, drops_short_reads), "reads of 1 byte"),
    "a crash on garbage": ("garbage", with_pipeline(ROTORLINK, crashes_on_damage), "KeyError: 'unknown frame'"),
    "losses dropped": ("garbage", with_pipeline(ROTORLINK, drops_losses), "no loss was counted"),
    "one loss too many": ("damage", with_pipeline(ROTORLINK, miscounts), "claims to count exactly"),
    "lost bytes dropped": ("damage", with_pipeline(CIA402, drops_losses), "no loss was counted"),
    "losses without an event": ("lost reads", with_pipeline(ROTORLINK, keeps_quiet), "no event reports it"),
    "a claim that does not hold": ("lost reads", with_pipeline(OPTONCDT, miscounts), "claims to count exactly"),
    "samples that wait for ever": (
        "end",
        with_pipeline(OPTONCDT, waits_after_a_late_read),
        "samples are missing, 0 counted",
    ),
    "an end that gives again": ("end", with_pipeline(OPTONCDT, gives_twice), "given again"),
    "a loss that no end shows": ("end", with_pipeline(OPTONCDT, drops_losses), "0 counted as lost"),
    "deaf after a restart": (
        "restart",
        with_pipeline(OPTONCDT, ends_at_a_restart),
        "samples came after a restart",
    ),
    "a wrap taken for a restart": ("counter wrap", with_pipeline(OPTONCDT, restarts_at_a_wrap), "restart"),
    "a clock that is not unwrapped": (
        "clock wrap",
        with_pipeline(ROTORLINK, on_batches(column("node_time_us", lambda v: v % np.uint64(2**32)))),
        "node_time_us",
    ),
    "all bytes kept": ("memory", with_pipeline(CIA402, hoards), "it uses"),
    "a crash on damage": ("mutations", with_pipeline(ROTORLINK, crashes_on_damage), "KeyError"),
    "a checksum there is not": (
        "mutations",
        with_pipeline(CIA402, on_batches(lambda b: b), frozenset({"checksum"})),
        "claims a checksum",
    ),
    "a stop that raises": ("stop", STOP_RAISES, "RuntimeError: no such command"),
    "a stop that stops nothing": (
        "stop",
        replace(OPTONCDT, stop=lambda settings, talk: None),
        "claims that it falls silent",
    ),
    "a stop after which nothing opens": ("stop", replace(OPTONCDT, stop=stops_for_ever), "LinkLost"),
    "another error than the contract's": (
        "link lost",
        replace(OPTONCDT, stop=stop_of_a_lost_link_raises),
        "got OSError",
    ),
    "permission not requested": (
        "speed source",
        replace(CIA402, speed_source=requests_no_permission),
        "permit raises, it raised nothing",
    ),
    "silence taken for off": (
        "speed source",
        replace(VESC, speed_source=takes_silence_for_off),
        "disable: the device does not answer",
    ),
    "no time-out of its own": (
        "stops by itself",
        replace(VESC, far_end=lambda device, settings, world: SimulatedVesc(settings, world.motion, timeout_s=1e9)),
        "turns at",
    ),
    "locks that do nothing": ("locks", replace(ROTORLINK, locks=locks_only_acknowledge), "the flags are"),
    "a stand-in without a word": (
        "played",
        replace(OPTONCDT, played=lambda settings, identity: PlayedDevice()),
        "no answer",
    ),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_driver_fails_for_the_right_reason(how: str) -> None:
    name, driver, why = BROKEN[how]
    (case,) = [case for case in rig_testing.cases(driver) if case.name == name]
    outcome = case.run()
    assert not outcome.passed, f"passed: {outcome.why}"
    assert re.search(re.escape(why), outcome.why), outcome.why


def test_every_test_of_the_kit_has_been_seen_red() -> None:
    assert {name for name, _, _ in BROKEN.values()} == set(CHECKS)


def test_what_does_not_apply_is_skipped_and_a_report_states_why() -> None:
    report = rig_testing.examine(STOP_RAISES)
    assert [outcome.name for outcome in report.failed] == ["waits", "stop", "link lost"]
    assert not report.passed
    skipped = {outcome.name: outcome.why for outcome in report.outcomes if not outcome.tried}
    assert skipped["displacement"] == "it measures no displacement"
    assert "wraps after" in skipped["counter wrap"]
