"""Opening and stop of a node: base station and node are identified, the node is started, then the beacon.

A node that samples does not answer, so it is set to idle first. Its set-up (rate, channels) is read and compared with
the rig file; nothing is written to its EEPROM.

Identification of a base station on an unknown port, and of the nodes whose samples it passes on.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from daq.drivers.questions import TRIES, ask
from daq.errors import DeviceError
from rig_drivers.microstrain import wire
from rig_drivers.microstrain.framing import Answer, PacketSearch, beacon_of
from rig_drivers.microstrain.rates import BASE_ADDRESS, RATES_HZ
from rig_drivers.microstrain.settings import MicroStrainNode
from rig_drivers.microstrain.stream import BEACON_LAG
from rig_drivers.microstrain.wire import Version

_NODE_TRIES = 5  # of a command to a node, which the radio may lose
_IDLE_S = 10.0  # s until a node is idle; unverified
_SUCCESS = 0
_BASE = (wire.BASE_SUCCESS, wire.BASE_ERROR)
_NODE = (wire.NODE_SUCCESS, wire.NODE_COMMAND, wire.NODE_ERROR)


def open_node(device: str, settings: MicroStrainNode, talk: Talk) -> dict[str, Any]:
    """Identify base station and node, start synchronized sampling, and set the beacon to the host's time.

    Returns:
        Identity: serial, firmware, base_serial, base_firmware (texts) and beacon_lag_ns.

    Raises:
        DeviceError: no answer, another node than the rig file's, or a node that is set up otherwise.
    """
    dialogue = _Dialogue(device, settings, talk)
    dialogue.ping()
    base = dialogue.identity(BASE_ADDRESS)
    if not dialogue.set_to_idle():
        raise DeviceError(
            f"{device}: node {settings.node_address} did not become idle within {_IDLE_S:g} s. Is it switched on, is "
            "node_address right, and does the base station use its radio channel?"
        )
    talk.restart_decoding()
    node = dialogue.identity(settings.node_address)
    if settings.serial and node["serial"] != settings.serial:
        raise DeviceError(
            f"{device}: node {settings.node_address} has the serial number {node['serial']}, the rig file states "
            f"{settings.serial}. Correct devices.{device}.serial, or use the right node and its calibration"
        )
    dialogue.compare_setup()
    dialogue.set_beacon(wire.BEACON_OFF)
    dialogue.start()
    dialogue.set_beacon(dialogue.next_second())
    base_names = {f"base_{name}": value for name, value in base.items()}
    return {**node, **base_names, **dialogue.beacon_lag()}


def stop_node(settings: MicroStrainNode, talk: Talk) -> None:
    """Set the node to idle, then switch the beacon off.

    Raises:
        DeviceError: the node does not confirm that it is idle; the beacon was switched off.
    """
    dialogue = _Dialogue(settings.port, settings, talk)
    idle = dialogue.set_to_idle()
    dialogue.set_beacon(wire.BEACON_OFF)
    if not idle:
        raise DeviceError(
            f"{settings.port}: node {settings.node_address} does not confirm that it is idle. Without the beacon it "
            "stops by itself after its own timeout; its battery is used until then"
        )


class _Dialogue:
    """Requests and answers; an answer belongs to a request by its command and its first arguments."""

    def __init__(self, device: str, settings: MicroStrainNode, talk: Talk) -> None:
        self._device, self._settings, self._talk = device, settings, talk

    def ping(self) -> None:
        """Ping the base station."""
        if self._ask(BASE_ADDRESS, wire.PING) is None:
            raise DeviceError(
                f"{self._device} on {self._settings.port}: no base station answers a ping in {TRIES} tries. Check "
                f"that it has power, baud = {self._settings.baud} (usual: 921600 by USB, 115200 by RS-232), and aspp = "
                f"{self._settings.aspp} (older base stations: 1, newer ones: 3)"
            )

    def identity(self, address: int) -> dict[str, str]:
        """Return serial number and firmware of the base station or of a node."""
        model, option, high, low = (self._read(address, place) for place in wire.IDENTITY_PLACES)
        return {
            "serial": wire.serial_number(model, option, high, low),
            "firmware": wire.firmware_version(self._read(address, wire.FIRMWARE)),
        }

    def compare_setup(self) -> None:
        """Compare the node's rate and channels with the rig file."""
        settings, node = self._settings, self._settings.node_address
        code, mask = self._read(node, wire.SAMPLE_RATE), self._read(node, wire.CHANNEL_MASK)
        if RATES_HZ.get(code) != settings.rate_Hz:
            raise DeviceError(
                f"{self._device}: the rig file states rate_Hz = {settings.rate_Hz}, node {node} is set to "
                f"{RATES_HZ.get(code, f'rate code {code}')}. Correct devices.{self._device}.rate_Hz, or set up the node"
            )
        if missing := [number for number in settings.used_channels if not mask >> (number - 1) & 1]:
            raise DeviceError(
                f"{self._device}: channel {', '.join(map(str, missing))} of node {node} is not active. Activate it in "
                "the node's set-up, or correct the channels in the rig file"
            )

    def set_to_idle(self) -> bool:
        """Command the base station to set the node to idle; return whether the node is idle."""
        argument = wire.node_bytes(self._settings.aspp, self._settings.node_address)
        request = wire.request(self._settings.aspp, BASE_ADDRESS, wire.SET_TO_IDLE, argument)
        expected = wire.SET_TO_IDLE.to_bytes(2, "big") + argument

        def found_in(reply: str) -> int | None:
            answer = Answer.of_text(reply)
            fits = answer.kind == wire.BASE_SUCCESS and answer.payload[:-1] == expected
            return answer.payload[-1] if fits else None

        return ask(self._talk, request, found_in, _IDLE_S, tries=1) == _SUCCESS

    def start(self) -> None:
        """Start synchronized sampling; the node waits for the beacon."""
        node = self._settings.node_address
        if self._ask(node, wire.START_SYNC) is None:
            raise DeviceError(f"{self._device}: node {node} does not confirm the start of synchronized sampling")

    def set_beacon(self, utc_s: int) -> None:
        """Set the beacon's time, s since 1970, or switch it off."""
        if self._ask(BASE_ADDRESS, wire.SET_BEACON, utc_s.to_bytes(4, "big")) is None:
            raise DeviceError(f"{self._device}: the base station does not confirm the command to set its beacon")

    def next_second(self) -> int:
        """Wait until a second of the host's clock begins; return it, s since 1970."""
        clock = self._talk.clock
        second = clock.now_ns() // 10**9 + 1
        clock.wait(max(0, second * 10**9 - clock.now_ns()) * 1e-9)
        return second

    def beacon_lag(self) -> dict[str, int]:
        """Return the host's time minus the beacon's as part of the identity; empty without an answer."""
        answer = self._ask(BASE_ADDRESS, wire.BEACON_STATUS)
        beacon = None if answer is None else beacon_of(answer)
        if answer is None or beacon is None or not beacon.is_on:
            return {}
        return {BEACON_LAG: answer.host_ns - beacon.time_ns}

    def _read(self, address: int, place: int) -> int:
        """Return a word of the EEPROM of the base station or of a node."""
        command = wire.BASE_READ if address == BASE_ADDRESS else wire.NODE_READ
        answer = self._ask(address, command, place.to_bytes(2, "big"))
        if answer is None or len(answer.payload) != 6:
            who = "the base station" if address == BASE_ADDRESS else f"node {address}"
            raise DeviceError(f"{self._device}: {who} does not answer the query of its EEPROM at {place}")
        return int.from_bytes(answer.payload[4:], "big")

    def _ask(self, address: int, command: int, data: bytes = b"") -> Answer | None:
        """Repeat a request until it is answered; return the answer, None without one.

        Raises:
            DeviceError: the request is refused.
        """
        to_base = address == BASE_ADDRESS
        kinds = _BASE if to_base else _NODE
        status = command == wire.BEACON_STATUS
        start = command.to_bytes(2, "big") + data

        def found_in(reply: str) -> Answer | None:
            answer = Answer.of_text(reply)
            fits = (answer.address, answer.payload[: len(start)]) == (address, start) and answer.kind in kinds
            return answer if fits else None

        request = wire.request(self._settings.aspp, address, command, data)
        answer = ask(self._talk, request, found_in, tries=TRIES if to_base else _NODE_TRIES)
        if answer is not None and answer.kind in (wire.BASE_ERROR, wire.NODE_ERROR) and not status:
            who = "the base station" if to_base else f"node {address}"
            raise DeviceError(
                f"{self._device}: {who} refuses command {command:04X}h with code {answer.payload[-1]}: "
                f"{wire.ERRORS.get(answer.payload[-1], 'unknown')}"
            )
        return answer


def identity_turns(settings: MicroStrainNode) -> IdentityTurns:
    """Ping the base station, then read its serial number and firmware from its EEPROM.

    No packet is sent by radio. The address of the node is that of the node with most samples among the received bytes;
    an idle node sends none.
    """
    heard = yield _request(settings.aspp, wire.PING)
    if _answer(heard, settings.aspp, wire.PING) is None:
        return None
    words: dict[int, int | None] = {}
    for place in (*wire.IDENTITY_PLACES, wire.FIRMWARE):
        words[place], received = yield from _word(settings.aspp, place)
        heard += received
    identity: dict[str, str | int] = {"sensor": "base station"}
    model, option, high, low, firmware = words.values()
    if model is not None and option is not None and high is not None and low is not None:
        identity["base_serial"] = wire.serial_number(model, option, high, low)
    if firmware is not None:
        identity["base_firmware"] = wire.firmware_version(firmware)
    return FoundDevice({"baud": settings.baud, "aspp": settings.aspp, **_node(heard, settings.aspp)}, identity)


def _word(version: Version, place: int) -> Generator[IdentityRequest, bytes, tuple[int | None, bytes]]:
    """Read a word of the base station's EEPROM; return it, None without an answer, and the received bytes."""
    data = place.to_bytes(2, "big")
    received = yield _request(version, wire.BASE_READ, data)
    answer = _answer(received, version, wire.BASE_READ, data)
    return None if answer is None or len(answer) != 2 else int.from_bytes(answer, "big"), received


def _request(version: Version, command: int, data: bytes = b"") -> IdentityRequest:
    request = wire.request(version, BASE_ADDRESS, command, data)
    return IdentityRequest(request, lambda got: _answer(got, version, command, data) is not None)


def _answer(data: bytes, version: Version, command: int, arguments: bytes = b"") -> bytes | None:
    """Return what an answer of the base station contains after the command and its arguments; None without it."""
    start = command.to_bytes(2, "big") + arguments
    for packet in PacketSearch(version).feed(data).packets:
        if (packet.kind, packet.address) == (wire.BASE_SUCCESS, BASE_ADDRESS) and packet.payload.startswith(start):
            return packet.payload[len(start) :]
    return None


def _node(data: bytes, version: Version) -> dict[str, int]:
    """Return address and sample rate of the node with most packets of samples; empty without one."""
    rates: dict[int, list[int]] = {}
    for packet in PacketSearch(version).feed(data).packets:
        try:
            content = wire.sweeps_of(packet, version)
            sweeps = None if content is None else wire.parse_sweeps(content, version)
        except ValueError:  # usual: a damaged packet that the check let pass
            continue
        if sweeps is not None and (rate_Hz := RATES_HZ.get(sweeps.rate_code)) is not None:
            rates.setdefault(packet.address, []).append(rate_Hz)
    if not rates:
        return {}
    address = max(rates, key=lambda each: len(rates[each]))
    return {"node_address": address, "rate_Hz": Counter(rates[address]).most_common(1)[0][0]}
