# pyright: strict
"""`--foxglove`: what is recorded, watched or played, for Foxglove and Lichtblick on this machine."""

from __future__ import annotations

import re
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rig_cli import answer
from rig_cli.console import say
from rig_configs import RigFileError

if TYPE_CHECKING:
    from daq.acquisition.session import Session
    from daq.log import Log
    from live.foxglove.beside import FoxgloveBeside
    from live.transport import Transport
    from rig_configs.schema import Rig

_ORIGIN = re.compile(r"[a-z][a-z0-9+.-]*://[^/\s?#A-Z*]+")


@Parameter(name="*")
@dataclass(frozen=True)
class Foxglove:
    """Whether and how the connection is offered.

    Attributes:
        wanted: whether it is.
        port: on the loopback; there is no way to let other machines in.
        origins: of pages in a browser that may connect.
    """

    wanted: Annotated[
        bool,
        Parameter(
            name="--foxglove",
            negative="",
            help="give it to Foxglove and Lichtblick too, read-only, on this "
            "machine alone; they send no token, so anyone on this machine can read it",
        ),
    ] = False
    port: Annotated[int, Parameter(name="--foxglove-port", help="of that connection; 0 for any free one")] = 8765
    origins: Annotated[
        list[str],
        Parameter(
            name="--foxglove-origin",
            negative="",
            help="a page in a browser that may connect, e.g. https://app.foxglove.dev; the desktop programs need none",
        ),
    ] = field(default_factory=list[str])


def foxglove_beside(
    asked: Foxglove | None, rig: Rig, rate: float, as_json: bool, told: Callable[[str], None] = say
) -> AbstractContextManager[FoxgloveBeside | None]:
    """The connection of a session that is opened inside this context; nothing where it is not wanted.

    Args:
        rig: the session's.
        rate: seconds of the rig per second of the wall.
    """
    return _beside(asked, rig, rate, as_json, told) if asked is not None and asked.wanted else nullcontext()


@contextmanager
def _beside(
    asked: Foxglove, rig: Rig, rate: float, as_json: bool, told: Callable[[str], None]
) -> Generator[FoxgloveBeside]:
    from live.foxglove.beside import FoxgloveBeside  # noqa: PLC0415 (only where it is asked for)

    beside = FoxgloveBeside(rig, rate, asked.port, _checked(asked.origins), told)
    try:
        with beside:
            _announce(beside.url, as_json, told)
            yield beside
    finally:
        _say_left_out(beside.left_out, told)


def follow_session(beside: FoxgloveBeside | None, session: Session) -> None:
    """Have the connection, where there is one, show an open session."""
    if beside is not None:
        beside.follow(session)


@contextmanager
def foxglove_of_log(
    asked: Foxglove | None, log: Log, rig: Rig, transport: Transport, origin_ns: int, as_json: bool
) -> Generator[None]:
    """The connection of a log that is played; nothing where it is not wanted.

    Args:
        log: open; it is read here and not needed afterwards.
        rig: its rig.
        transport: where it stands, s since origin_ns.
        origin_ns: ns since 1970.
    """
    if asked is None or not asked.wanted:
        yield
        return
    from live.foxglove.played import Giving, Played  # noqa: PLC0415 (only where it is asked for)
    from live.foxglove.served import Refusals, facts_of  # noqa: PLC0415
    from live.foxglove.server import FoxgloveServer  # noqa: PLC0415

    played = Played(log)
    metadata = {**facts_of(rig), "log": log.path.name}
    server = FoxgloveServer(log.path.name, played.offered, metadata, _checked(asked.origins), asked.port, Refusals(say))
    with server, Giving(played, transport, origin_ns, server):
        _announce(server.url, as_json, say)
        yield
    _say_left_out(server.left_out, say)


def _checked(origins: list[str]) -> tuple[str, ...]:
    for origin in origins:
        if not _ORIGIN.fullmatch(origin):
            raise RigFileError(
                f"--foxglove-origin {origin}: expected a page's scheme, name and port alone, in small letters, as "
                "browsers send them: https://app.foxglove.dev or http://localhost:8080"
            )
    return tuple(origins)


def _announce(url: str, as_json: bool, told: Callable[[str], None]) -> None:
    if as_json:
        answer.announce({"foxglove": url})
    told(
        f"for Foxglove and Lichtblick (open a connection, Foxglove WebSocket): {url}; read-only; it asks for no "
        "token: anyone on this machine can read it"
    )


def _say_left_out(left_out: int, told: Callable[[str], None]) -> None:
    if left_out:
        told(f"Foxglove connection: {left_out} messages were left out for clients that took less; the log has all")
