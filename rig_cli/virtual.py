"""`rig virtual`: starting the virtual rig, and operating it from another terminal."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, Parameter

from rig_basics.texts import number_of
from rig_cli.console import notify, print_json
from rig_cli.numbers import Positive, PositiveSeconds
from rig_cli.option_groups import OUTPUT
from rig_cli.options import Json, RigFile, Settings
from rig_configs import RigFileError, load_rig

app: App = App(name="virtual")

DeviceName = Annotated[str, Parameter(help="its name in the rig file")]
Control = Annotated[Path | None, Parameter(help="the file with the rig's control port and token, if several run")]
_SLOWLY_RPM_S = 20.0


@app.default
def start(
    rig: RigFile = "virtual",
    *,
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], group=OUTPUT, help="write its rig file: these ports, without [virtual]"),
    ] = None,
    link: Annotated[Literal["auto", "pty", "tcp"], Parameter(help="wires of its devices")] = "auto",
    control: Control = None,
    settings: Settings = None,
    while_stdin_open: Annotated[bool, Parameter(negative="", show=False)] = False,
    json: Json = False,
) -> None:
    """Start a virtual rig and print its ports as one JSON line; Ctrl-C or `rig virtual stop` ends it.

    Example: `rig virtual`
    """
    from daq.virtual_rig.run import VirtualRig, serve  # only this command simulates
    from rig_cli.plugged_rig_file import need_free, write_plugged

    loaded = load_rig(rig, settings=settings or [])
    if output is not None:
        need_free(output)
    virtual = VirtualRig(loaded, link)

    def ready(note: Path | None) -> None:
        if output is not None:
            write_plugged(rig, settings or [], virtual.ports(), output)
        print_json(
            {
                "ports": virtual.ports(),
                "control_port": virtual.control.port,
                "token": virtual.token,
                "control": str(note) if note else None,
                "rig_file": str(output) if output else None,
            }
        )
        if not while_stdin_open and not json:
            _report_usage(loaded.name, virtual.ports(), output, note if control else None)

    serve(virtual, ready, control, leaves_note=control is not None or not while_stdin_open, until_eof=while_stdin_open)


def _report_usage(rig: str, ports: Mapping[str, str], output: Path | None, note: Path | None) -> None:
    """Print examples of commands for other terminals."""
    set_ports = "".join(f" --set devices.{name}.port={port}" for name, port in ports.items())
    chosen = f" --control {note}" if note else ""
    notify(f"for example: rig check {output if output else rig}{'' if output else set_ports}")
    notify(f"to operate it: rig virtual pluck x{chosen}, or flick, clamp, turn, fault, unplug, plug, state, stop")


@contextmanager
def _operator(control: Path | None) -> Generator[Any]:
    """Yield the connection to the running rig. A rejected request is reported as bad use.

    Raises:
        RigFileError: the rig rejected a request, or several rigs run.
        NoRigRuns: no rig runs.
    """
    from daq.virtual_rig.running import NoRigRuns, SeveralRigsRun, reach

    try:
        _, line = reach(control)
    except NoRigRuns as error:
        chosen = f" --control {control}" if control else ""
        raise NoRigRuns(f"{error}, in another terminal: rig virtual{chosen}") from error
    except SeveralRigsRun as error:
        rows = "".join(f"\n  --control {path}   ({rig})" for path, rig in error.choices)
        raise RigFileError(
            f"{number_of(len(error.choices), 'virtual rig runs', 'virtual rigs run')}; choose one:{rows}"
        ) from error
    try:
        yield line
    except ValueError as error:
        raise RigFileError(str(error)) from error
    finally:
        line.close()


def _done(json: bool, words: str, **facts: Any) -> None:
    if json:
        print_json({"done": True, **facts})
    else:
        notify(words)


def _by_hand(control: Path | None, act: Callable[[Any], None]) -> None:
    from daq.virtual_rig.simulated_operator import SimulatedOperator

    with _operator(control) as line:
        act(SimulatedOperator(line))


@app.command
def pluck(
    axis: Annotated[Literal["x", "y"], Parameter(help="of the sensors")],
    *,
    mm: Annotated[Positive | None, Parameter(help="how far; default: as a ring-down requires")] = None,
    control: Control = None,
    json: Json = False,
) -> None:
    """Displace the column along an axis and release it.

    Example: `rig virtual pluck x`
    """
    _by_hand(control, lambda hand: hand.pluck(axis, mm))
    _done(json, f"plucked along {axis}")


@app.command
def flick(*, control: Control = None, json: Json = False) -> None:
    """Set both pendulums spinning, one each way, slower than two turns a second.

    Example: `rig virtual flick`
    """
    _by_hand(control, lambda hand: hand.flick())
    _done(json, "flicked both pendulums")


@app.command
def clamp(
    *,
    release: Annotated[bool, Parameter(negative="", help="release both pendulums")] = False,
    control: Control = None,
    json: Json = False,
) -> None:
    """Hold both pendulums at their places, A at 0° and B at 180°, if no device does; or release them.

    Example: `rig virtual clamp`
    """
    _by_hand(control, lambda hand: hand.release() if release else hand.lock(seen=True))
    _done(json, "released both pendulums" if release else "holding both pendulums at their places")


@app.command
def turn(
    rpm: Annotated[float, Parameter(help="speed to be reached")],
    *,
    ramp: Annotated[Positive, Parameter(help="rpm per second")] = _SLOWLY_RPM_S,
    control: Control = None,
    json: Json = False,
) -> None:
    """Bring the rotor to a speed and hold it there, if no drive does; 0: to rest.

    Example: `rig virtual turn 600`
    """
    _by_hand(control, lambda hand: hand.turn(rpm, ramp))
    _done(json, f"turning the rotor to {rpm:g} rpm by {ramp:g} rpm/s")


@app.command(name="set")
def set_(
    setting: Annotated[str, Parameter(help="KEY=VALUE of the rig file")], *, control: Control = None, json: Json = False
) -> None:
    """Change the rig itself, as a moved clamp does: KEY=VALUE, e.g. suspension.k2_N_per_m=+5%.

    Example: `rig virtual set suspension.k2_N_per_m=+5%`
    """
    from rig_configs import parse_setting

    key, value = parse_setting(setting)
    with _operator(control) as line:
        line.ask("set", key=key, value=value)
    _done(json, f"{key} of the virtual rig is changed: {value}")


@app.command
def fault(
    kind: str | None = None,
    device: str | None = None,
    *,
    value: Annotated[float | None, Parameter(help="how much; see --list")] = None,
    seconds: Annotated[PositiveSeconds | None, Parameter(help="after which it ends by itself")] = None,
    end: Annotated[bool, Parameter(negative="", help="end it")] = False,
    list_: Annotated[bool, Parameter(name="--list", negative="", help="list the faults of each device")] = False,
    control: Control = None,
    json: Json = False,
) -> None:
    """Place a fault in a device.

    Example: `rig virtual fault mute laser_x`

    Args:
        kind: the fault; its words may be joined by hyphens.
        device: its name in the rig file; may be left out if only one device can have this fault.
    """
    from rig_cli.virtual_page import show_faults

    with _operator(control) as line:
        kinds: dict[str, dict[str, Any]] = line.ask("faults")["devices"]
        if list_ or kind is None:
            if not list_:
                raise RigFileError(f"expected a fault; `rig virtual fault --list` shows those of {', '.join(kinds)}")
            print_json({"devices": kinds}) if json else show_faults(kinds)
            return
        what, chosen = _chosen(kind, device, kinds)
        request: dict[str, Any] = {"device": chosen, "what": what, "end": end}
        request |= {name: given for name, given in (("value", value), ("seconds", seconds)) if given is not None}
        line.ask("fail", **request)
    words = "ended" if end else f"placed: {kinds[chosen].get(what, {}).get('words', what)}"
    _done(json, f"{chosen}: {what} {words}{f', for {seconds:g} s' if seconds else ''}", device=chosen, fault=what)


def _chosen(kind: str, device: str | None, kinds: Mapping[str, Mapping[str, Any]]) -> tuple[str, str]:
    """Return the fault under its own name, and the device."""
    having = {
        name: next((own for own in known if own.replace(" ", "-") == kind.replace(" ", "-")), "")
        for name, known in kinds.items()
    }
    able = [name for name, what in having.items() if what]
    if device is not None and device not in kinds:
        raise RigFileError(f"no device {device!r}; this rig has {', '.join(kinds)}")
    if not able:
        known = ", ".join(dict.fromkeys(what for each in kinds.values() for what in each))
        raise RigFileError(f"no device can have {kind!r}; they can have: {known}")
    if device is None and len(able) > 1:
        raise RigFileError(f"{kind!r}: of which device? {', '.join(able)} can have it")
    chosen = device or able[0]
    if chosen not in able:
        raise RigFileError(f"{chosen} cannot have {kind!r}, only {', '.join(able)}")
    return having[chosen], chosen


@app.command
def unplug(device: DeviceName, *, control: Control = None, json: Json = False) -> None:
    """Pull a device's cable.

    Example: `rig virtual unplug laser_x`
    """
    with _operator(control) as line:
        line.ask("unplug", device=device)
    _done(json, f"{device}: cable pulled", device=device)


@app.command
def plug(device: DeviceName, *, control: Control = None, json: Json = False) -> None:
    """Plug a device in again; its port may have another name now.

    Example: `rig virtual plug laser_x`
    """
    with _operator(control) as line:
        port = str(line.ask("plug", device=device)["port"])
    _done(
        json, f"{device}: plugged in at {port}; use it by --set devices.{device}.port={port}", device=device, port=port
    )


@app.command
def state(*, control: Control = None, json: Json = False) -> None:
    """Show the state of the rig: motion, ports, present faults.

    Example: `rig virtual state`
    """
    from rig_cli.virtual_page import onlooker, show_state

    with _operator(control) as line:
        seen = onlooker(line.ask("state"))
    print_json(seen) if json else show_state(seen)


@app.command
def stop(*, control: Control = None, json: Json = False) -> None:
    """End the running rig.

    Example: `rig virtual stop`
    """
    with _operator(control) as line:
        line.ask("quit")
        line.wait_for_end()
    _done(json, "the virtual rig has ended")
