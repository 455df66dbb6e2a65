"""Opening of a converter: its state is read until it answers. No command is sent."""

from __future__ import annotations

from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.questions import ask
from daq.errors import DeviceError
from rig_basics.texts import number_of
from rig_drivers.modbus_converter import wire
from rig_drivers.modbus_converter.settings import ModbusConverter

_TRIES = 4


def is_read(reply: str) -> bool:
    """Whether a reply of the pipeline consists of the registers read, and not of a refusal."""
    return reply.replace(" ", "").isdigit()


def identify(device: str, settings: ModbusConverter, talk: Talk) -> dict[str, Any]:
    """Read the state of the converter until it answers.

    Returns:
        Identity: table and address. A converter reports neither model nor serial number in a standard register.

    Raises:
        DeviceError: the converter does not answer, or refuses the read.
    """
    register, count = settings.blocks[0]
    request = wire.encode(wire.Request(settings.address, settings.registers.read_function, register, count))
    before = talk.bytes_in

    def found_in(reply: str) -> bool:
        if not is_read(reply):
            raise DeviceError(f'{device} on {settings.port}: {reply}. Is the register table "{settings.table}" right?')
        return True

    if ask(talk, request, found_in, 2 * settings.answer_s, _TRIES):  # the next request must not meet a late answer
        talk.clock.wait(settings.answer_s)  # the converter's pause before the first request of `control`
        return {"table": settings.table, "address": settings.address}
    heard = talk.bytes_in - before
    came = f"{number_of(heard, 'byte')} came, none of them that answer" if heard else "nothing came"
    if heard == _TRIES * len(request):
        came = f"as many bytes came as were sent ({heard}), as from an adapter that returns the host's own bytes,"
    raise DeviceError(
        f"{device} on {settings.port}: no answer to a read of {number_of(count, 'register')} from "
        f"{register} on, {came} in {_TRIES} "
        f"tries. Is the converter powered, its Modbus address {settings.address}, its line at {settings.baud} baud, "
        f"parity {settings.parity}, {number_of(settings.stop_bits, 'stop bit')}, and is the register table right?"
    )
