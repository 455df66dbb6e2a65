"""Access control of the page: Host, Origin and token are checked here only.

    request ─▶ Host one of ours? ──no──▶ 400
             ─▶ token correct?    ──no──▶ 403
             ─▶ Origin           foreign: 403; missing: 403 for commands and connections (WebSocket, POST)
             ─▶ the page, with headers that forbid everything it does not need

The connection for Foxglove has no token (`judge_without_token`): Host as above, and Origins of a short list only.

A browser on this machine visits other pages too. The Host check rejects names that were redirected to this machine (DNS
rebinding), the Origin check rejects scripts of other pages, and the token rejects other users of the machine.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Collection, Mapping, Sequence
from typing import Any
from urllib.parse import parse_qs

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
"""Names of this machine in its own browser."""
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "connect-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Connection": "close",
}
"""Headers of every response. BokehJS styles its elements inline: without 'unsafe-inline' its layout breaks. A
connection ends with its response, so that each request of a browser passes `live.entrance`."""
_SENDS = ("POST", "PUT", "PATCH", "DELETE")


def new_token() -> str:
    """Return an unpredictable token of 256 bits."""
    return secrets.token_urlsafe(32)


def hosts_of(name: str, port: int) -> list[str]:
    """Return the accepted values of the Host header.

    Args:
        name: name to which the server is bound; "" for the loopback.
        port: port of the server.
    """
    names = [*LOOPBACK, *([f"[{name}]" if ":" in name else name] if name and name not in LOOPBACK else [])]
    return [f"{each}:{port}" for each in names] + ([*names] if port == 80 else [])


class Access:
    """Rules for every request.

    Args:
        token: token that every request must contain as `?token=…`.
        hosts: accepted values of the Host header with the port: "127.0.0.1:8123".
    """

    def __init__(self, token: str, hosts: Collection[str]) -> None:
        self._token, self._hosts = token.encode(), frozenset(host.lower() for host in hosts)

    def judge(self, scope: Mapping[str, Any]) -> tuple[int, str]:
        """Return 200, or the status of a refusal with its reason.

        Args:
            scope: request as in ASGI: type, headers (names in lower case), query_string, method.
        """
        host = _only(scope, b"host")
        if host is None or host.lower() not in self._hosts:
            return 400, f"expected a Host of {', '.join(sorted(self._hosts))}; open the address that rig live printed"
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])
        if len(given) != 1 or not hmac.compare_digest(given[0].encode(), self._token):
            return 403, "expected the token of this page; open the whole address that rig live printed"
        origins = [value for name, value in scope["headers"] if name.lower() == b"origin"]
        ours = f"http://{host}".lower()
        if any(origin.decode("latin-1").lower() != ours for origin in origins) or len(origins) > 1:
            return 403, f"expected the Origin {ours}: other pages may not send requests to this one"
        if not origins and (scope["type"] == "websocket" or scope.get("method") in _SENDS):
            return 403, f"expected the Origin {ours}, got none: send requests from the page"
        return 200, ""


class Guard:
    """An application behind the access control.

    Args:
        app: guarded application.
        token, hosts: as for Access.
    """

    def __init__(self, app: ASGIApp, token: str, hosts: Collection[str]) -> None:
        self._app, self._access = app, Access(token, hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request; see ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        status, why = self._access.judge(scope)
        if status != 200:
            answer = PlainTextResponse(f"{why}\n", status, HEADERS)
            if scope["type"] == "websocket":
                await WebSocket(scope, receive, send).send_denial_response(answer)
            else:
                await answer(scope, receive, send)
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                ours = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]
                kept = [(n, v) for n, v in message.get("headers", ()) if n.lower() not in dict(ours)]
                message = {**message, "headers": [*kept, *ours]}
            await send(message)

        await self._app(scope, receive, guarded)


DESKTOP_ORIGINS = ("file://",)
"""Origins of Electron programs such as Lichtblick, whose pages are files. A page that a browser opens from a file, or a
page in a sandbox, sends "null" (Chromium, Firefox) and is refused."""


def judge_without_token(
    hosts: Sequence[str], origins: Sequence[str], ours: Collection[str], allowed: Collection[str]
) -> tuple[int, str]:
    """Return 200, or the status of a refusal with its reason, for a protocol without a token.

    A client that sends no Origin is not a page in a browser and is accepted.

    Args:
        hosts, origins: values of these headers.
        ours: accepted Hosts with the port, in lower case.
        allowed: Origins of pages that may connect, in addition to DESKTOP_ORIGINS.
    """
    if len(hosts) != 1 or hosts[0].lower() not in ours:
        return 400, f"expected a Host of {', '.join(sorted(ours))}"
    if len(origins) > 1 or any(origin not in (*DESKTOP_ORIGINS, *allowed) for origin in origins):
        return 403, "expected no Origin or an allowed one: pages of other origins may not read this rig"
    return 200, ""


def _only(scope: Mapping[str, Any], name: bytes) -> str | None:
    """Return a header that may occur once; None if it is missing or repeated."""
    found = [value for key, value in scope["headers"] if key.lower() == name]
    return found[0].decode("latin-1") if len(found) == 1 else None
