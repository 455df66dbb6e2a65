"""CANopen encoders (CiA 406) as a driver."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from daq import channels
from daq.channels import Channel
from daq.drivers.can_lines import close_bus
from daq.drivers.contract import Poller
from daq.drivers.driver import Driver, parts_of
from rig_drivers.cia406.settings import FAULT_KEYS, EncoderBus

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


def _angles(settings: EncoderBus) -> tuple[Channel, ...]:
    return (channels.PENDULUMS,)


def _marks(settings: EncoderBus) -> tuple[Channel, ...]:
    """Return the index marks, if there is an encoder on the shaft."""
    return () if settings.shaft_node is None else (channels.TACHO,)


def _poller(settings: EncoderBus, send: Callable[[bytes], None], clock: HostClock) -> Poller:
    """Return the sender of SYNC."""
    from rig_drivers.cia406.sync_sender import NoRequests, SyncSender

    return SyncSender(settings, send, clock) if settings.sync else NoRequests()


_part = parts_of("rig_drivers.cia406")
DRIVER = Driver(
    name="cia406",
    settings=EncoderBus,
    pause_s=0.001,
    example={"a_node": 3, "b_node": 4, "shaft_node": 5},
    claims=frozenset({"falls silent"}),
    measured=frozenset(f"{name}_{key}" for name in ("a", "b", "shaft") for key in FAULT_KEYS),
    channels=_angles,
    occasional=_marks,
    pipeline=_part("stream:EncoderPipeline"),
    poller=_poller,
    words=_part("stream:emergency_words"),
    checks=_part("stream:encoder_checks"),
    far_end=_part("far_end:SimulatedEncoders.of"),
    played=_part("far_end:PlayedEncoders"),
    open=_part("dialogue:open_encoders"),
    stop=close_bus,  # without the host's SYNC the encoders sample no more
    identity_request=_part("dialogue:identity_turns"),
)
