"""CANopen encoders (CiA 406) as a driver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, Poller, SpeedControl, Talk
from daq.drivers.driver import Driver, parts_of
from daq.items import DeviceEvent
from daq.transports.can_frames import CLOSE_BUS
from rig_drivers.cia406.settings import FAULT_KEYS, EncoderBus

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


def _line(settings: EncoderBus) -> DeviceLine:
    return DeviceLine(settings.port, settings.baud, settings.bitrate)


def _angles(settings: EncoderBus) -> tuple[Channel, ...]:
    return (channels.PENDULUMS,)


def _marks(settings: EncoderBus) -> tuple[Channel, ...]:
    """Return the index marks, if there is an encoder on the shaft."""
    return () if settings.shaft_node is None else (channels.TACHO,)


def _poller(settings: EncoderBus, send: Callable[[bytes], None], clock: HostClock) -> Poller:
    """Return the sender of SYNC."""
    from rig_drivers.cia406.sync_sender import NoRequests, SyncSender

    return SyncSender(settings, send, clock) if settings.sync else NoRequests()


def _words(event: DeviceEvent) -> str:
    from daq.drivers.canopen import cia301

    code = int(event.facts["error_code"])
    return f"of encoder {event.facts['encoder']}: {cia301.emergency_words(code)}" if code else ""


def _checks(settings: EncoderBus, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    from rig_drivers.cia406.status_checks import encoder_checks

    codes = [_words(event) for event in events if event.kind == "emergency"]
    return encoder_checks(pipeline, [words for words in codes if words])


def _open(device: str, settings: EncoderBus, talk: Talk) -> dict[str, Any]:
    from rig_drivers.cia406.dialogue import open_encoders

    return {"driver": "cia406", **open_encoders(device, settings, talk)}


def _stop(settings: EncoderBus, talk: Talk) -> None:
    """Close the bus at the adapter. The host's SYNC has ended, so the encoders sample no more."""
    talk.send(CLOSE_BUS)


_part = parts_of("rig_drivers.cia406")
DRIVER = Driver(
    name="cia406",
    settings=EncoderBus,
    rest_s=0.001,
    example={"a_node": 3, "b_node": 4, "shaft_node": 5},
    claims=frozenset({"falls silent"}),
    measured=frozenset(f"{name}_{key}" for name in ("a", "b", "shaft") for key in FAULT_KEYS),
    line=_line,
    channels=_angles,
    occasional=_marks,
    pipeline=_part("stream:EncoderPipeline"),
    poller=_poller,
    words=_words,
    checks=_checks,
    far_end=_part("far_end:SimulatedEncoders.of"),
    played=_part("played:PlayedEncoders"),
    open=_open,
    stop=_stop,
    identity_request=_part("identity:identity_turns"),
)
