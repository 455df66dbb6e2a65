"""Identification of a polled displacement sensor on an unknown port: one request for a value."""

from __future__ import annotations

from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from rig_drivers.polled_laser import wire
from rig_drivers.polled_laser.settings import PolledLaser


def identity_turns(settings: PolledLaser) -> IdentityTurns:
    """Request a value, which changes nothing in the sensor; it reports neither its model nor its serial number.

    A refusal (`ER,…`) is not accepted: other devices answer unknown commands in similar ways. Nor is an answer with
    another end than the dialect's: an LK-G answers the IL's request too.
    """
    dialect = wire.DIALECTS[settings.dialect]

    def reading(data: bytes) -> wire.Reading | None:
        lines = data.split(dialect.end)[:-1] if dialect.end != b"\r" else data.replace(b"\n", b"").split(b"\r")[:-1]
        parsed = (dialect.parse(line, settings.output) for line in lines if len(line) <= wire.LONGEST_LINE_BYTES)
        return next((found for found in parsed if isinstance(found, wire.Reading)), None)

    request = b"\r" + dialect.request(settings.output)  # the first CR ends a line that another request has begun
    if reading((yield IdentityRequest(request, lambda data: reading(data) is not None))) is None:
        return None
    keys = ("dialect", "output", "baud", "parity")
    return FoundDevice({key: getattr(settings, key) for key in keys}, {"sensor": dialect.sensors})
