"""Opening of a polled displacement sensor: requests until it answers one.

Identification of a polled displacement sensor on an unknown port: one request for a value.
"""

from __future__ import annotations

from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from daq.drivers.questions import ask
from daq.errors import DeviceError
from rig_drivers.polled_laser import wire
from rig_drivers.polled_laser.settings import PolledLaser

_TRIES = 4


def identify(device: str, settings: PolledLaser, talk: Talk) -> dict[str, Any]:
    """Request a value until the sensor answers.

    Returns:
        Identity: dialect and output. The sensor reports neither its model nor its serial number.

    Raises:
        DeviceError: the sensor does not answer, or refuses the request.
    """
    dialect = wire.DIALECTS[settings.dialect]
    request = dialect.request(settings.output)
    refusal = other = ""

    def found_in(reply: str) -> wire.Reading | None:
        nonlocal refusal, other
        answer = reply.encode("latin-1")
        found = dialect.parse(answer, settings.output)
        if isinstance(found, wire.Refusal):  # the first request may have been joined to the rest of an earlier one
            refusal = f"got {answer!r}: {found.why}"
        elif found is None:
            other = repr(answer)
        return found if isinstance(found, wire.Reading) else None

    if ask(talk, request, found_in, tries=_TRIES) is not None:
        return {"dialect": settings.dialect, "output": settings.output}
    if refusal:
        raise DeviceError(
            f"{device} on {settings.port}: expected a value for {request!r}, {refusal}. Check "
            f"devices.{device}.output, and that the sensor is in its measuring state"
        )
    if other:
        raise DeviceError(
            f"{device} on {settings.port}: expected an answer to {request!r} from a {dialect.sensors}, output "
            f"{settings.output}, got {other}. Check devices.{device}.dialect and output (of an HL-G1 its address), "
            "baud and parity, and that the sensor sends only on request"
        )
    raise DeviceError(
        f"{device} on {settings.port}: no answer to {request!r} in {_TRIES} tries. Is it a {dialect.sensors} with "
        f"output {settings.output} (of an HL-G1 its address), {settings.baud} baud, parity {settings.parity}, and does "
        "the line carry both directions?"
    )


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
