"""`rig live`: a rig or a log in the browser; and the same page for other commands, by their `--live`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from daq.errors import LogError
from rig_cli import answer
from rig_cli.console import notify
from rig_cli.foxglove import NOT_OFFERED, Foxglove, follow_session, foxglove_of_log, foxglove_of_session
from rig_cli.option_groups import DISPLAYS
from rig_cli.options import Json, ParametersPath, Settings, warn_of_filled, warn_of_unusual_settings
from rig_configs import IdentifiedParameters, load_rig, overridden, with_parameters

if TYPE_CHECKING:
    from daq.acquisition.session import Session
    from daq.guided_tests.controls import Controls
    from live.session_page import LivePage
    from rig_configs.schema import Rig

Host = Annotated[str, Parameter(help="admit other machines: the name or address by which they reach this one")]
Port = Annotated[int, Parameter(help="of the page; 0 for any free one")]


@Parameter(name="*", group=DISPLAYS)
@dataclass(frozen=True)
class PagePlace:
    """Address of the page of `rig live`.

    Attributes:
        host: name or address of this machine for other machines; "" for this machine only.
        port: 0 for any free one.
    """

    host: Host = ""
    port: Port = 0


_LOCAL = PagePlace()


@Parameter(name="*", group=DISPLAYS)
@dataclass(frozen=True)
class Displays:
    """Displays of a running session besides the terminal.

    Attributes:
        live: whether a live page is shown.
        live_host, live_port: address of that page.
        foxglove: options of the connection for Foxglove.
    """

    live: Annotated[
        bool, Parameter(negative="", help="show it in the browser too, with a stop button; see rig live")
    ] = False
    live_host: Annotated[str, Parameter(help="of that page, as rig live's --host")] = ""
    live_port: Annotated[int, Parameter(help="of that page, as rig live's --port")] = 0
    foxglove: Foxglove = field(default_factory=Foxglove)

    @property
    def page(self) -> PagePlace | None:
        """Address of the live page; None without one."""
        return PagePlace(self.live_host, self.live_port) if self.live else None


TERMINAL_ONLY = Displays()


_CHECK_EVERY_S = 0.1


def live(
    source: Annotated[str, Parameter(help="a log, a rig file or a shipped rig's name")],
    *,
    place: PagePlace = _LOCAL,
    speed: Annotated[float, Parameter(help="of a log: seconds of it per second")] = 1.0,
    parameters: ParametersPath = None,
    foxglove: Foxglove = NOT_OFFERED,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Show a rig or a log in the browser, with a stop button.

    Access to the page needs its token. Ctrl-C ends it. A log is played: play, pause, seek, speed. A rig is opened
    and watched, and nothing is recorded; its page has a stop button. With --json the first line is {"url",
    "token"}.

    Example: `rig live run.mcap`
    """
    if source.endswith((".mcap", ".mcap.part")):
        return _log(Path(source), place, speed, parameters, foxglove, settings or [], json)
    return _rig(source, place, parameters, foxglove, settings or [], json)


def _log(
    path: Path,
    place: PagePlace,
    speed: float,
    parameters: Path | None,
    foxglove: Foxglove,
    settings: list[str],
    as_json: bool,
) -> int:
    from daq.log import open_log  # numba takes a third of a second to import
    from daq.log.snapshot import rig_of
    from live.model import LiveModel
    from live.replayed import Replayed
    from live.serving import Serving

    with ExitStack() as stack:
        with open_log(path) as log:
            rig, known, source = _laid_over(rig_of(log, settings), parameters, settings)
            try:
                replayed = Replayed(log, rig, speed)
            except ValueError as fault:
                raise LogError(f"--speed: {fault}") from fault
            serving = stack.enter_context(Serving(replayed, LiveModel(rig, known, source), place.host, place.port))
            _announce(serving.url, serving.token, place.host, as_json)
            origin_ns = replayed.signals.origin_ns
            stack.enter_context(foxglove_of_log(foxglove, log, rig, replayed.transport, origin_ns, as_json))
        try:
            threading.Event().wait()
        except KeyboardInterrupt:  # usual: Ctrl-C ends it
            notify("the page is closed")
    return 0


def _rig(
    name: str,
    place: PagePlace,
    parameters: Path | None,
    foxglove: Foxglove,
    settings: list[str],
    as_json: bool,
) -> int:
    from daq.acquisition.session import Session
    from daq.transports import HostClock

    rig = load_rig(name, settings=settings)
    warn_of_unusual_settings(rig)
    clock = HostClock()
    with (
        page_of_session(place, rig, parameters, settings, as_json) as page,
        foxglove_of_session(foxglove, rig, as_json) as given,
        Session(rig, clock, notify=notify) as session,
    ):
        follow(page, session, session.stop, {"words": "watched, not recorded"})
        follow_session(given, session)
        try:
            while True:
                session.check()
                time.sleep(_CHECK_EVERY_S)
        except KeyboardInterrupt:  # usual: Ctrl-C ends it
            notify("the page is closed")
    return 3 if session.notices else 0


def page_of_session(
    place: PagePlace | None,
    rig: Rig,
    parameters: Path | None,
    settings: list[str],
    as_json: bool,
    notify: Callable[[str], None] = notify,
) -> AbstractContextManager[LivePage | None]:
    """Return a context with the page of a session opened inside it; None without `--live`.

    Args:
        place: address of the page; None for no page.
        rig: the session's.
        parameters, settings: of the model's curves.
    """
    if place is None:
        return nullcontext()
    laid, known, source = _laid_over(rig, parameters, settings)
    from live.session_page import LivePage  # numba takes a third of a second to import

    class Announced(LivePage):
        def __enter__(self) -> LivePage:
            page = super().__enter__()
            _announce(page.url, page.token, place.host, as_json, notify)
            return page

    return Announced(laid, known, source, rig.name, place.host, place.port)


def follow(
    page: LivePage | None,
    session: Session,
    stop: Callable[[str], None] | None,
    facts: Mapping[str, Any],
    controls: Controls | None = None,
    confirmed: Callable[[], None] | None = None,
) -> Callable[[str], None]:
    """Show an open session on the page, if there is one; see live.session_page.

    Returns:
        Function to be called with every prompt to the operator.
    """
    if page is None:
        return lambda text: None
    from live.session_page import Asking  # only with a page

    asking = Asking(controls, confirmed)
    page.follow(session, asking, stop, facts)
    return asking.prompt


def _laid_over(rig: Rig, parameters: Path | None, settings: list[str]) -> tuple[Rig, IdentifiedParameters | None, str]:
    """Return the rig with identified parameters applied, these parameters, and the source of the model's numbers."""
    if parameters is None:
        return rig, None, "rig file"
    known = IdentifiedParameters.load(parameters)
    warn_of_filled(known, rig, settings)
    return with_parameters(rig, known.without(overridden(known, settings))), known, parameters.name


def _announce(url: str, token: str, host: str, as_json: bool, notify: Callable[[str], None] = notify) -> None:
    """Report the page's address, with JSON output as its first line."""
    if host:
        notify(
            f"warning: --host {host}: all who reach this machine and have that address see the page and may press its "
            "stop; it is not encrypted, so the token can be read on the network"
        )
    address: Mapping[str, Any] = {"url": url, "token": token}
    if as_json:
        answer.announce(address)
    notify(f"the live page: {url}")
