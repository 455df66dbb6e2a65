"""Recognition of a RotorLink node by its frames. Nothing is sent: node and dongle report their status each second."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from daq.drivers.identification import FoundDevice
from daq.drivers.rotorlink import wire
from daq.drivers.rotorlink.line import FrameDecoder
from daq.drivers.rotorlink.settings import EncoderNode


def recognise(settings: EncoderNode, data: bytes) -> FoundDevice | None:
    """Return number, sample rate and counts per revolution of the node with most blocks; see `Driver.recognise`."""
    frames = [frame.inner if isinstance(frame, wire.Wrapped) else frame for frame in FrameDecoder().feed(data).frames]
    return node_of(frames, {"baud": settings.baud})


def node_of(frames: Sequence[object], known: Mapping[str, str | int]) -> FoundDevice | None:
    """Return the node that sends most blocks of samples; None without a block.

    Args:
        frames: frames of nodes, possibly among others.
        known: settings that are known already.
    """
    blocks = [frame for frame in frames if isinstance(frame, wire.EncoderBlock)]
    if not blocks:
        return None
    (node, _), *others = Counter(block.node for block in blocks).most_common()
    found: dict[str, str | int] = {**known, "node": node}
    period_us = next(block.period_us for block in blocks if block.node == node)
    if period_us:
        found["rate_Hz"] = round(1e6 / period_us)
    identity: dict[str, str | int] = {"node": node}
    if others:
        identity["other_nodes"] = ", ".join(str(other) for other, _ in others)
    for frame in frames:
        if isinstance(frame, wire.NodeStatus) and frame.node == node:
            found["counts_per_revolution"] = frame.counts_per_revolution
            firmware = f"{frame.firmware_major}.{frame.firmware_minor}"
            identity |= {"firmware": firmware, "battery_mV": frame.battery_mv}
    return FoundDevice(found, identity)
