"""HTTP server of the page: the page, its frames over a WebSocket, and commands to the rig.

Pictures are made for each viewer when its connection is ready and earlier ones are answered. A slow, sleeping or dead
viewer receives fewer pictures and delays nothing else. Every request passes `live.guard`.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import time
from collections.abc import Callable
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from live.errors import CommandRefused
from live.guard import Guard
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
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_BOKEH = ("bokeh.min.js", "bokeh-api.min.js")
_VIEWER_ENDS = (WebSocketDisconnect, ValueError, TypeError, KeyError, OSError, RuntimeError)
_log = logging.getLogger(__name__)


class _Viewer:
    """Connection to one browser."""

    def __init__(self, socket: WebSocket, pictures: Pictures, looked_at: Callable[[], None]) -> None:
        self._socket, self._pictures, self._looked_at = socket, pictures, looked_at
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
        """Receive views and answers until the connection ends."""
        while True:
            message = json.loads(await self._socket.receive_text())
            if not isinstance(message, dict):
                raise ValueError("expected an object")
            request = cast("dict[str, Any]", message)
            if "view" in request:
                self.view = ViewerView.of(request["view"])
            if "seen" in request:
                self.answered = max(self.answered, min(int(request["seen"]), self.sent))
                self._free.set()
                self._looked_at()

    async def show(self, extra: Callable[[], Facts]) -> None:
        """Send the newest pictures, never more than the connection and the viewer accept."""
        await self._socket.send_bytes(self._pictures.curves())
        state_s = slow_s = -1e9
        due = time.monotonic()
        while True:
            if self._full() and not self._state_asked:
                self._free.clear()
                await self._free.wait()
            now = time.monotonic()
            if self._state_asked or now - state_s >= _STATE_S:
                self._state_asked, state_s = False, now
                facts = {**self._pictures.state(), **extra(), "missed": self.missed}
                await self._socket.send_text(storable(json.dumps(facts, ensure_ascii=False)))
                self.state_sent_s = now
            if self._full():
                continue
            if now - slow_s >= _SLOW_S:
                slow_s = now
                await self._socket.send_bytes(self._pictures.slow())
            self.sent += 1
            await self._socket.send_bytes(self._pictures.frame(self.view, self.sent))
            due += 1 / FRAMES_PER_S
            late = time.monotonic() - due
            if late > 1 / FRAMES_PER_S:
                skipped = int(late * FRAMES_PER_S)
                self.missed += skipped
                due += skipped / FRAMES_PER_S
            await asyncio.sleep(max(0.0, due - time.monotonic()))


class PageApplication:
    """The application behind the guard.

    Args:
        source: displayed source, which carries out the commands.
        pictures: pictures of it.
        token: token of the page.
    """

    def __init__(self, source: PageSource, pictures: Pictures, token: str) -> None:
        self._source, self._pictures, self._token = source, pictures, token
        self._viewers: list[_Viewer] = []
        self._files = {path.name: path for path in _files()}

    def app(self, hosts: list[str]) -> ASGIApp:
        """Return the guarded application; see Guard."""
        routes = [
            Route("/", self._index),
            Route("/page/{name}", self._file),
            WebSocketRoute("/data", self._data),
            Route("/stop", self._stop, methods=["POST"]),
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
        return HTMLResponse(text.replace("{{token}}", self._token))

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
        tasks = [asyncio.create_task(viewer.listen()), asyncio.create_task(viewer.show(self._extra))]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
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
        return {"viewers": len(self._viewers)}

    async def _stop(self, request: Request) -> Response:
        del request
        return await self._forward("stop", {})

    async def _act(self, request: Request) -> Response:
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > _MAX_MESSAGE_BYTES:
                return JSONResponse({"error": f"expected at most {_MAX_MESSAGE_BYTES} bytes"}, 413)
        try:
            given = json.loads(body)
            verb = str(given.pop("verb"))
        except (ValueError, KeyError, AttributeError, TypeError):  # usual: answered
            return JSONResponse({"error": 'expected {"verb": …} as JSON'}, 400)
        if len(str(given.get("text", ""))) > _MAX_NOTE_LETTERS:
            return JSONResponse({"error": f"expected a note of at most {_MAX_NOTE_LETTERS} characters"}, 413)
        return await self._forward(verb, cast("dict[str, Any]", given))

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
