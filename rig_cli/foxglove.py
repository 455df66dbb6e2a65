"""`--foxglove`: data that are recorded, watched or played, for Foxglove and Lichtblick on this machine."""

from __future__ import annotations

import re
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rig_basics.texts import number_of
from rig_cli import answer
from rig_cli.console import notify
from rig_cli.option_groups import DISPLAYS
from rig_configs import RigFileError

if TYPE_CHECKING:
    from daq.acquisition.session import Session
    from daq.log import Log
    from live.foxglove.session_connection import FoxgloveConnection
    from live.transport import Transport
    from rig_configs.schema import Rig

_ORIGIN = re.compile(r"[a-z][a-z0-9+.-]*://[^/\s?#A-Z*]+")


@Parameter(name="*", group=DISPLAYS)
@dataclass(frozen=True)
class Foxglove:
    """Options of the connection.

    Attributes:
        wanted: whether it is offered.
        port: port on the loopback interface; other machines cannot connect.
        origins: origins of pages in a browser that may connect.
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


NOT_OFFERED = Foxglove()


def foxglove_of_session(
    options: Foxglove, rig: Rig, as_json: bool, notify: Callable[[str], None] = notify
) -> AbstractContextManager[FoxgloveConnection | None]:
    """Return a context that offers a session opened inside it to Foxglove; None without the option.

    Args:
        rig: the session's.
    """
    if not options.wanted:
        return nullcontext()
    return _open_connection(options, rig, as_json, notify)


@contextmanager
def _open_connection(
    options: Foxglove, rig: Rig, as_json: bool, notify: Callable[[str], None]
) -> Generator[FoxgloveConnection]:
    from live.foxglove.session_connection import FoxgloveConnection  # only if requested

    connection = FoxgloveConnection(rig, options.port, _checked(options.origins), _refusal_reporter(notify))
    try:
        with connection:
            _announce(connection.url, as_json, notify)
            yield connection
    finally:
        _report_skipped(connection.left_out, notify)


def follow_session(connection: FoxgloveConnection | None, session: Session) -> None:
    """Show an open session on the connection, if there is one."""
    if connection is not None:
        connection.follow(session)


@contextmanager
def foxglove_of_log(
    options: Foxglove, log: Log, rig: Rig, transport: Transport, origin_ns: int, as_json: bool
) -> Generator[None]:
    """Offer a log that is played; does nothing without the option.

    Args:
        log: open log; it is read here and not needed afterwards.
        rig: its rig.
        transport: playing position, s since origin_ns.
        origin_ns: ns since 1970.
    """
    if not options.wanted:
        yield
        return
    from live.foxglove.played import LogMessages, LogSender  # only if requested
    from live.foxglove.served import Refusals, facts_of
    from live.foxglove.server import FoxgloveServer

    played = LogMessages(log)
    metadata = {**facts_of(rig), "log": log.path.name}
    refusals = Refusals(_refusal_reporter(notify))
    server = FoxgloveServer(log.path.name, played.offered, metadata, _checked(options.origins), options.port, refusals)
    with server, LogSender(played, transport, origin_ns, server):
        _announce(server.url, as_json, notify)
        yield
    _report_skipped(server.left_out, notify)


def _checked(origins: list[str]) -> tuple[str, ...]:
    for origin in origins:
        if not _ORIGIN.fullmatch(origin):
            raise RigFileError(
                f"--foxglove-origin {origin}: expected a page's scheme, name and port alone, in small letters, as "
                "browsers send them: https://app.foxglove.dev or http://localhost:8080"
            )
    return tuple(origins)


def _announce(url: str, as_json: bool, notify: Callable[[str], None]) -> None:
    if as_json:
        answer.announce({"foxglove": url})
    notify(
        f"for Foxglove and Lichtblick (open a connection, Foxglove WebSocket): {url}; read-only and without a token: "
        "any user of this machine can read it"
    )


def _refusal_reporter(notify: Callable[[str], None]) -> Callable[[str], None]:
    def report(origin: str) -> None:
        notify(
            f"warning: --foxglove: a page of {origin} asked for the rig's data and was refused; if it is one that "
            f"you use, begin with --foxglove-origin {origin}"
        )

    return report


def _report_skipped(left_out: int, notify: Callable[[str], None]) -> None:
    if left_out:
        notify(
            f"Foxglove connection: {number_of(left_out, 'message was', 'messages were')} skipped for slow "
            f"clients; the log contains all"
        )
