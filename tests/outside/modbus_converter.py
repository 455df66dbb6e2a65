"""A frequency converter on the RTU server of pymodbus, at the other end of two ptys."""

from __future__ import annotations

import asyncio
import os
import select
import threading
import time
import tty

from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerType
from pymodbus.server import ModbusSerialServer
from pymodbus.simulator import DataType, SimData, SimDevice

TICK_S = 0.01


class OutsideConverter:
    """A converter with the registers of an Altivar: speeds of the motor in rpm, a sign for the direction.

    Attributes:
        port: the port of the host.
        words: its registers.
        rpm: speed of its motor.
    """

    CONTROL, REFERENCE, STATUS, SPEED, FAULT = 8501, 8602, 3201, 8604, 8606
    ACCELERATION, DECELERATION, WATCHDOG = 9001, 9002, 6005
    MAX_RPM = 1000.0  # 50 Hz with three pole pairs: the end of its ramps

    def __init__(self, address: int) -> None:
        self.rpm = 0.0
        self.words = {self.CONTROL: 0, self.REFERENCE: 0, self.STATUS: 0x40, self.SPEED: 0, self.FAULT: 0}
        self.words |= {self.ACCELERATION: 30, self.DECELERATION: 30, self.WATCHDOG: 100}
        self._silent_s, self._enabled = 0.0, False
        host, server = os.openpty(), os.openpty()
        for slave in (host[1], server[1]):
            tty.setraw(slave)
        self.port, self._masters, self._slaves = os.ttyname(host[1]), (host[0], server[0]), (host[1], server[1])
        self._ended, self._ready = threading.Event(), threading.Event()
        data = [SimData(register, values=word, datatype=DataType.REGISTERS) for register, word in self.words.items()]
        device = SimDevice(address, simdata=sorted(data, key=lambda each: each.address), action=self._accessed)
        self._threads = [
            threading.Thread(target=work, daemon=True)
            for work in (self._carry, self._turn, lambda: asyncio.run(self._serve(device, os.ttyname(server[1]))))
        ]
        for thread in self._threads:
            thread.start()
        assert self._ready.wait(10.0)

    def close(self) -> None:
        """End server, cable and motor."""
        self._ended.set()
        for thread in self._threads:
            thread.join(10.0)
        for descriptor in (*self._masters, *self._slaves):
            os.close(descriptor)

    async def _serve(self, device: SimDevice, port: str) -> None:
        server = ModbusSerialServer(device, framer=FramerType.RTU, port=port, baudrate=19_200)
        await server.serve_forever(background=True)
        self._ready.set()
        while not self._ended.is_set():
            await asyncio.sleep(0.02)
        await server.shutdown()

    async def _accessed(
        self, function: int, start: int, address: int, count: int, current: list[int], given: list[int] | None
    ) -> ExcCodes | None:
        self._silent_s = 0.0
        for register in range(address, address + count):
            if given is not None:
                self.words[register] = given[register - address]
            else:
                current[register - start] = self.words[register]
        if given is not None and address == self.CONTROL:
            self._enabled = self.words[self.CONTROL] == 0x000F
            self.words[self.STATUS] = {0x6: 0x21, 0x7: 0x23, 0xF: 0x27}.get(self.words[self.CONTROL] & 0xF, 0x40)
        return None

    def _turn(self) -> None:
        last = time.monotonic()
        while not self._ended.wait(TICK_S):
            now = time.monotonic()
            passed_s, last = now - last, now
            self._silent_s += passed_s
            if self._silent_s > 0.1 * self.words[self.WATCHDOG]:
                self._enabled, self.words[self.FAULT], self.words[self.STATUS] = False, 0x7510, 0x08
            wanted = (self.words[self.REFERENCE] ^ 0x8000) - 0x8000 if self._enabled else 0
            ramp = self.words[self.ACCELERATION if self._enabled else self.DECELERATION]
            step = self.MAX_RPM / (0.1 * max(1, ramp)) * passed_s
            self.rpm += max(-step, min(wanted - self.rpm, step))
            self.words[self.SPEED] = round(self.rpm) & 0xFFFF

    def _carry(self) -> None:
        """Pass bytes between both ptys, as a cable does."""
        one, other = self._masters
        while not self._ended.is_set():
            for ready in select.select([one, other], [], [], 0.05)[0]:
                os.write(other if ready == one else one, os.read(ready, 4096))
