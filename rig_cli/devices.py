"""`rig devices`: the ports of this machine and the devices on them, with tables for a rig file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from rig_basics.texts import number_of
from rig_cli.console import notify, print_json
from rig_cli.options import Json

if TYPE_CHECKING:
    from daq.discovery.network import Announced
    from daq.discovery.ports import SerialPort
    from daq.discovery.search import Result
    from daq.drivers.driver import Driver
    from daq.transports import HostClock

_OPENED = ("device", "unknown device", "silent")
_SHOW_S = 0.1  # period of the progress bar


def devices(
    *,
    ask: Annotated[
        bool, Parameter(negative="", help="also send requests for identification, which only read; see above")
    ] = False,
    port: Annotated[
        list[str] | None,
        Parameter(help="search this port only, also socket://HOST:PORT or can:INTERFACE:CHANNEL; may be repeated"),
    ] = None,
    network: Annotated[
        bool, Parameter(negative="", help="also find devices on the network; sends broadcasts if a driver has one")
    ] = False,
    list_only: Annotated[bool, Parameter(negative="", help="list the ports, open none of them")] = False,
    json: Json = False,
) -> int:
    """List the ports and the devices on them, with tables to paste into a rig file.

    Without --ask no byte is sent; shown is the driver whose samples have the fewest losses. The exit code is 3 if a
    port that --port names cannot be opened.

    Requests of --ask. optoncdt: `GETINFO`, `MEASRATE` without a value. riftek: identification of address 1, parameters
    08h and 09h. polled_laser: one value by `M1`, `MS,01`, `M0`, `%01#RMD**`. xbee: local AT queries `AP`, `SH`, `SL`,
    `VR`, `HV`. vesc: firmware version. microstrain: ping of a base station. cia402, cia406: slcan `V`; `L` (listen
    only; `M1`, `O`, `M0` of a CANable) at each bit rate, `O` at that of the bus, or at 500 kbit/s on a silent bus
    (another rate is not found); SDO uploads of 1000h from each node, of 1018h from drive or encoders, of 6000h and
    6001h or 6501h from an encoder; `C`. rotorlink, riftek_ethernet and optoncdt_ethernet send by themselves. odrive,
    vesc_can (if the bus is closed), labjack and modbus_converter get none: write their tables by hand; labjack answers
    --network.

    Example: `rig devices --ask`
    """
    from daq.discovery.ports import can_channels, serial_ports, usb_can_adapters
    from daq.discovery.trials import drivers_found
    from daq.transports.host_clock import HostClock

    drivers, notes = drivers_found()
    serial = serial_ports() if port is None else []
    can = can_channels(network) if port is None else []
    adapters = usb_can_adapters() if port is None else []
    if port is not None:
        searched = dict.fromkeys(port, ask)
    else:  # a port of the board may be a console of the system: it is asked only by its name
        searched = {each.stable: ask and each.usb is not None for each in serial} | dict.fromkeys(_passive(can), ask)
    clock = HostClock()
    results = [] if list_only else _searched(searched, drivers, clock)
    announced: list[Announced] = []
    if network:
        from daq.discovery.network import announced_devices

        announced, failed = announced_devices(drivers, clock)
        notes += failed
    for note in notes:
        notify(f"rig: {note}")
    facts = {
        "serial_ports": [_port_facts(each) for each in serial],
        "can_channels": [each.port for each in can],
        "usb_can_adapters": [_adapter_facts(each) for each in adapters],
        "ports": [_result_facts(each) for each in results],
        "network": [_announced_facts(each) for each in announced],
        "tables": _tables(results, announced),
        "notes": notes,
    }
    unopened = port is not None and any(each.state not in _OPENED for each in results)
    code = 3 if unopened else 0
    if json:
        print_json(facts)
        return code
    from rig_cli.devices_page import print_devices  # rich's tables are slow

    print_devices(facts, asked=ask, searched=not list_only)
    return code


def _passive(channels: Sequence[Any]) -> list[str]:
    """Return the CAN channels that can be received without taking part on the bus: those of the system (socketcan)."""
    return [each.port for each in channels if each.interface == "socketcan"]


def _searched(ports: Mapping[str, bool], drivers: Sequence[Driver], clock: HostClock) -> list[Result]:
    """Search all ports at the same time; the values are whether requests may be sent to a port."""
    from concurrent.futures import ThreadPoolExecutor, wait
    from threading import Event

    from daq.discovery.search import PortSearch
    from rig_cli.share_progress import share_progress

    if not ports:
        return []
    for driver in drivers:
        driver.load()
    shares, stopping = dict.fromkeys(ports, 0.0), Event()

    def search(port: str, ask: bool) -> Result:
        def show(activity: str, share: float) -> None:
            shares[port] = share
            if stopping.is_set():
                raise InterruptedError(f"{port}: {activity} was interrupted")

        result = PortSearch(port, drivers, clock, show).run(ask)
        shares[port] = 1.0
        return result

    text = f"searching {number_of(len(ports), 'port')}"
    with share_progress(text) as progress, ThreadPoolExecutor(len(ports)) as workers:
        try:
            found = [workers.submit(search, port, ask) for port, ask in ports.items()]
            while not all(each.done() for each in found):
                wait(found, _SHOW_S)
                progress(sum(shares.values()) / len(shares))
            return [each.result() for each in found]
        finally:
            stopping.set()


def _port_facts(port: SerialPort) -> dict[str, Any]:
    from daq.discovery.ports import usb_facts

    return {"device": port.device, "port": port.stable, "usb": usb_facts(port.usb)}


def _adapter_facts(adapter: Any) -> dict[str, Any]:
    from daq.discovery.ports import usb_facts

    return {"kind": adapter.kind, "usb": usb_facts(adapter.usb)}


def _result_facts(result: Result) -> dict[str, Any]:
    evidence = result.evidence
    return {
        "port": result.port,
        "state": result.state,
        "note": result.note,
        "driver": evidence and evidence.trial.driver.name,
        "how": result.how,
        "settings": dict(evidence.settings) if evidence else {},
        "identity": dict(evidence.found.identity) if evidence else {},
        "samples": evidence.samples if evidence else 0,
        "losses": evidence.losses if evidence else 0,
        "bytes_in": result.bytes_in,
        "other_drivers": list(result.others),
        "seconds": round(result.seconds, 2),
    }


def _announced_facts(announced: Announced) -> dict[str, Any]:
    device = announced.device
    return {"port": device.port, "driver": announced.driver.name, "identity": dict(device.found.identity)}


def _tables(results: Sequence[Result], announced: Sequence[Announced]) -> list[dict[str, str]]:
    from daq.discovery.tables import Table, device_tables
    from daq.drivers.identification import FoundDevice

    found = [
        Table(
            evidence.trial.driver,
            each.port,
            FoundDevice(evidence.settings, evidence.found.identity),
            evidence.trial.settings.roles("device"),
        )
        for each in results
        if (evidence := each.evidence) is not None
    ]
    found += [Table(each.driver, each.device.port, each.device.found) for each in announced]
    return [{"name": name, "text": text} for name, text in device_tables(found)]
