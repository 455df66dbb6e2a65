# pyright: strict
"""`rig live`: a rig or a log in the browser."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from cli.console import print_json, say
from cli.numbers import TimeScale
from cli.options import Json, ParametersPath, Settings
from daq.errors import LogError
from rig_configs import IdentifiedParameters, RigFileError, overridden, with_parameters

if TYPE_CHECKING:
    from live.model import Model
    from rig_configs.schema import Rig

Host = Annotated[str, Parameter(help="let others in: the name or address by which they reach this machine")]
Port = Annotated[int, Parameter(help="of the page; 0 for any free one")]


def live(
    source: Annotated[str, Parameter(help="a log, a rig file or a shipped rig's name")],
    *,
    host: Host = "",
    port: Port = 0,
    speed: Annotated[float, Parameter(help="of a log: seconds of it per second")] = 1.0,
    parameters: ParametersPath = None,
    time_scale: TimeScale = 1.0,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Show a rig or a log in the browser; the address has a token, and only who has it sees anything. Ctrl-C ends it.

    A log is played: play, pause, seek, speed. A rig is opened and watched, nothing is recorded; its page has a stop.
    """
    if source.endswith((".mcap", ".mcap.part")):
        return _log(Path(source), host, port, speed, parameters, settings or [], json)
    raise RigFileError(f"{source}: watching a rig is not there yet")


def _log(
    path: Path, host: str, port: int, speed: float, parameters: Path | None, settings: list[str], as_json: bool
) -> int:
    from daq.log import open_log  # noqa: PLC0415 (numba takes a third of a second to import)
    from daq.log.snapshot import rig_of  # noqa: PLC0415
    from live.replayed import Replayed  # noqa: PLC0415
    from live.serving import Serving  # noqa: PLC0415

    with open_log(path) as log:
        rig, model = model_of(rig_of(log, settings), parameters, settings)
        try:
            replayed = Replayed(log, rig, speed)
        except ValueError as fault:
            raise LogError(f"--speed: {fault}") from fault
    with Serving(replayed, model, host, port) as serving:
        announce({"url": serving.url, "token": serving.token}, host, as_json)
        wait_for_ctrl_c()
    return 0


def model_of(rig: Rig, parameters: Path | None, settings: list[str]) -> tuple[Rig, Model]:
    """A rig with identified parameters laid over it, and the model whose curves the page draws."""
    from live.model import Model  # noqa: PLC0415

    if parameters is None:
        return rig, Model(rig)
    known = IdentifiedParameters.load(parameters)
    laid = with_parameters(rig, known.without(overridden(known, settings)))
    return laid, Model(laid, known, parameters.name)


def announce(address: Mapping[str, Any], host: str, as_json: bool) -> None:
    """The page's address, as the first line of the output."""
    if as_json:
        print_json(address)
    else:
        print(address["url"], flush=True)
    say(f"the live page: {address['url']}")
    if host:
        say(f"warning: --host {host}: everybody who can reach this machine and has that address sees the page and may "
            "press its stop; it is not encrypted. Give the address to nobody else")  # fmt: skip


def wait_for_ctrl_c() -> None:
    """Wait until the person at the terminal has had enough."""
    try:
        threading.Event().wait()
    except KeyboardInterrupt as stop:
        if str(stop):
            say(f"ended by {stop}")
