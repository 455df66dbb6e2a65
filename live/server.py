"""HTTP server of the page: the page, its frames over a WebSocket, and commands to the rig except STOP.

Pictures are made for each viewer when its connection is ready and earlier ones are answered. A slow, sleeping or dead
viewer receives fewer pictures and delays nothing else, a viewer that floods is disconnected, and all pictures together
take at most half of the time of the thread. Every request passes `live.guard`; STOP is answered by `live.entrance`.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import time
from collections.abc import Callable, Collection
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from live.entrance import Connections
from live.errors import CommandRefused, InvalidRequest
from live.guard import Guard
from live.messages import parsed_object
from live.picture import Pictures, ViewerView
from live.source import Facts, PageSource
from rig_basics.ignoring import ignoring
from rig_basics.texts import storable

FRAMES_PER_S = 30.0
MOST_VIEWERS = 16
MOST_UNANSWERED = 3
"""Largest number of frames that a viewer has been sent without an answer, which bounds the queue of a sleeping one."""
_STATE_S, _SLOW_S, _LOOK_S = 0.2, 0.5, 0.02
_ANSWER_S = 2.0
_MAX_MESSAGE_BYTES, _MAX_NOTE_LETTERS = 4096, 2000
MOST_MESSAGES_PER_S = 240.0
"""Messages of one viewer over several seconds: an answer to each of 30 frames, and a view per picture of its screen
while it is zoomed (144 per second on a fast screen), with a reserve. So many more may come at once."""
_DRAWING_SHARE = 0.5  # of the thread's time; the rest is for files, commands and the operator's other connections
_BODY_S = 2.0
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_BOKEH = ("bokeh.min.js", "bokeh-api.min.js")
_VIEWER_ENDS = (WebSocketDisconnect, InvalidRequest, ValueError, TypeError, KeyError, OSError, RuntimeError)
_log = logging.getLogger(__name__)


class Allowance:
    """Number of messages that one viewer may still send; it refills with time.

    Args:
        clock: monotonic time, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._left, self._at_s = MOST_MESSAGES_PER_S, clock()

    def take(self) -> bool:
        """Count one message; False if too many have come."""
        now_s = self._clock()
        self._left = min(MOST_MESSAGES_PER_S, self._left + (now_s - self._at_s) * MOST_MESSAGES_PER_S) - 1
        self._at_s = now_s
        return self._left >= 0


def pause_s(drawing_s: float, viewers: int) -> float:
    """Return the least time from frame to frame of a viewer for which all pictures take their share of the time, s.

    Args:
        drawing_s: processor time of this viewer's pictures.
        viewers: number of viewers, each of which is drawn for in turn.
    """
    return drawing_s * viewers / _DRAWING_SHARE


class _Stopwatch:
    """Processor time of this thread within its contexts, s."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._begun = 0.0

    def __enter__(self) -> None:
        self._begun = time.thread_time()

    def __exit__(self, *_: object) -> None:
        self.seconds += time.thread_time() - self._begun


class _Viewer:
    """Connection to one browser."""

    def __init__(self, socket: WebSocket, pictures: Pictures, looked_at: Callable[[], None]) -> None:
        self._socket, self._pictures, self._looked_at = socket, pictures, looked_at
        self._allowance = Allowance()
        self.view = ViewerView()
        self.sent = self.answered = self.missed = 0
        self.state_sent_s = -math.inf  # time of the newest state that it was sent
        self._free = asyncio.Event()
        self._free.set()
        self._state_asked = False
        self._loop = asyncio.get_running_loop()

    def ask_state(self) -> None:
        """Send the current state even if frames are unanswered. Any thread."""
        with ignoring(_log, "the last state for a viewer of a server that has ended", RuntimeError):
            self._loop.call_soon_threadsafe(self._ask_state)

    def _ask_state(self) -> None:
        self._state_asked = True
        self._free.set()

    def _full(self) -> bool:
        return self.sent - self.answered >= MOST_UNANSWERED

    async def listen(self) -> None:
        """Receive views and answers until the connection ends.

        Raises:
            InvalidRequest: the viewer sends no object, or too many.
        """
        while True:
            text = await self._socket.receive_text()
            if not self._allowance.take():
                raise InvalidRequest(f"expected at most {MOST_MESSAGES_PER_S:g} messages per second")
            request = parsed_object(text)
            if "view" in request:
                self.view = ViewerView.of(request["view"])
            if "seen" in request:
                self.answered = max(self.answered, min(int(request["seen"]), self.sent))
                self._free.set()
                self._looked_at()

    async def show(self, extra: Callable[[], Facts], viewers: Callable[[], int]) -> None:
        """Send the newest pictures, never more than the connection and the viewer accept.

        Args:
            extra: further facts of the server.
            viewers: number of viewers.
        """
        await self._socket.send_bytes(self._pictures.curves())
        state_s = slow_s = -1e9
        due = time.monotonic()
        while True:
            if self._full() and not self._state_asked:
                self._free.clear()
                await self._free.wait()
            now = time.monotonic()
            drawing = _Stopwatch()
            if self._state_asked or now - state_s >= _STATE_S:
                self._state_asked, state_s = False, now
                with drawing:
                    facts = {**self._pictures.state(), **extra(), "missed": self.missed}
                    text = storable(json.dumps(facts, ensure_ascii=False))
                await self._socket.send_text(text)
                self.state_sent_s = now
            if self._full():
                continue
            if now - slow_s >= _SLOW_S:
                slow_s = now
                with drawing:
                    slow = self._pictures.slow()
                await self._socket.send_bytes(slow)
            self.sent += 1
            with drawing:
                frame = self._pictures.frame(self.view, self.sent)
            await self._socket.send_bytes(frame)
            due += 1 / FRAMES_PER_S
            now = time.monotonic()
            rested = now + pause_s(drawing.seconds, viewers()) - drawing.seconds
            late = max(now, rested) - due
            if late > 1 / FRAMES_PER_S:
                skipped = int(late * FRAMES_PER_S)
                self.missed += skipped
                due += skipped / FRAMES_PER_S
            await asyncio.sleep(max(0.0, max(due, rested) - now))


class PageApplication:
    """The application behind the guard.

    Args:
        source: displayed source, which carries out the commands.
        pictures: pictures of it.
        token: token of the page.

    Attributes:
        connections: counts of the entrance, if it is in this process.
    """

    def __init__(self, source: PageSource, pictures: Pictures, token: str) -> None:
        self._source, self._pictures, self._token = source, pictures, token
        self.connections: Connections | None = None
        self._viewers: list[_Viewer] = []
        self._dropped = 0
        self._files = {path.name: path for path in _files()}

    def app(self, hosts: Collection[str]) -> ASGIApp:
        """Return the guarded application; see Guard."""
        routes = [
            Route("/", self._index),
            Route("/page/{name}", self._file),
            WebSocketRoute("/data", self._data),
            Route("/act", self._act, methods=["POST"]),
        ]
        return Guard(Starlette(routes=routes), self._token, hosts)

    @property
    def viewers(self) -> int:
        """Number of connected browsers."""
        return len(self._viewers)

    def flush_state(self, timeout_s: float) -> None:
        """Send every viewer the current state and wait until that is done, or until the timeout. Any thread."""
        begun_s = time.monotonic()
        for viewer in list(self._viewers):  # a busy one has not answered its frames and would show the run as stale
            viewer.ask_state()
        late_s = begun_s + timeout_s
        while any(viewer.state_sent_s < begun_s for viewer in list(self._viewers)) and time.monotonic() < late_s:
            time.sleep(_LOOK_S)

    def _index(self, request: Request) -> Response:
        del request
        text = self._files["index.html"].read_text(encoding="utf-8")
        rig = "" if self._source.facts()["mode"] == "replay" else 'data-rig="yes"'  # STOP exists before any state
        return HTMLResponse(text.replace("{{token}}", self._token).replace("{{rig}}", rig))

    def _file(self, request: Request) -> Response:
        path = self._files.get(request.path_params["name"])
        if path is None or path.name == "index.html":
            return PlainTextResponse("no such file of the page\n", 404)
        return Response(path.read_bytes(), media_type=_TYPES.get(path.suffix, "application/octet-stream"))

    async def _data(self, socket: WebSocket) -> None:
        if len(self._viewers) >= MOST_VIEWERS:
            await socket.send_denial_response(PlainTextResponse(f"{MOST_VIEWERS} viewers are already connected\n", 503))
            return
        await socket.accept()
        viewer = _Viewer(socket, self._pictures, self._source.looked_at)
        self._viewers.append(viewer)
        tasks = [
            asyncio.create_task(viewer.listen()),
            asyncio.create_task(viewer.show(self._extra, lambda: len(self._viewers))),
        ]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                self._dropped += isinstance(task.exception(), InvalidRequest)
                with ignoring(_log, "a viewer's connection", *_VIEWER_ENDS):
                    task.result()
        finally:
            self._viewers.remove(viewer)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            with ignoring(_log, "closing a viewer's connection", Exception):
                await socket.close()

    def _extra(self) -> Facts:
        counts = {} if self.connections is None else {"connections": self.connections}
        return {**counts, "viewers": len(self._viewers), "dropped_viewers": self._dropped}

    async def _act(self, request: Request) -> Response:
        body = b""
        try:
            async with asyncio.timeout(_BODY_S):
                async for part in request.stream():
                    body += part
                    if len(body) > _MAX_MESSAGE_BYTES:
                        return JSONResponse({"error": f"expected at most {_MAX_MESSAGE_BYTES} bytes"}, 413)
            given = parsed_object(body)
            verb = str(given.pop("verb"))
        except (InvalidRequest, KeyError, TimeoutError):  # usual: answered
            return JSONResponse({"error": 'expected {"verb": …} as JSON'}, 400)
        if len(str(given.get("text", ""))) > _MAX_NOTE_LETTERS:
            return JSONResponse({"error": f"expected a note of at most {_MAX_NOTE_LETTERS} characters"}, 413)
        return await self._forward(verb, given)

    async def _forward(self, verb: str, given: dict[str, Any]) -> Response:
        """Forward a command in this thread; another thread would double the delay on a busy machine."""
        try:
            return JSONResponse(await asyncio.wait_for(asyncio.wrap_future(self._source.act(verb, given)), _ANSWER_S))
        except CommandRefused as why:
            return JSONResponse({"error": str(why)}, 409)
        except TimeoutError:
            _log.info("%s: no answer from the recorder within %g s", verb, _ANSWER_S)
            return JSONResponse({"error": f"{verb}: no answer from the recorder within {_ANSWER_S:g} s"}, 409)


def _files() -> list[Path]:
    """Return our own files, and BokehJS of the installed package."""
    own = [Path(str(entry)) for entry in resources.files("live").joinpath("page").iterdir()]
    spec = find_spec("bokeh")  # only its files are needed
    assert spec is not None
    assert spec.origin is not None
    scripts = Path(spec.origin).parent / "server" / "static" / "js"
    return [*(path for path in own if path.suffix in _TYPES), *(scripts / name for name in _BOKEH)]
