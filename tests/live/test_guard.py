"""Who gets anything from the page: every refusal, on page, data and stop alike."""

import base64
import socket
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPMessage
from urllib.parse import quote

import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from live.guard import HEADERS, Guard, hosts_of, new_token

TOKEN = "Tr3s-geheim_0123456789-abcdefghijklmnopqrstu"
OURS = "127.0.0.1:8123"
ORIGIN = f"http://{OURS}"
FOREIGN_HOSTS = ["evil.example:8123", "127.0.0.1:8124", "127.0.0.1", "127.0.0.1.evil.example:8123", ""]
FOREIGN_ORIGINS = [
    "http://evil.example",
    "https://127.0.0.1:8123",
    "http://127.0.0.1:8124",
    "http://localhost:8123",
    "null",
    "http://127.0.0.1:8123.evil.example",
    "http://127.0.0.1:8123/",
    "",
]
WRONG_TOKENS = ["", TOKEN[:-1], TOKEN + "x", TOKEN.swapcase(), "é"]
PLACES = ["page", "data", "stop"]


async def _page(request: Request) -> PlainTextResponse:
    return PlainTextResponse("let in", headers={"cache-control": "max-age=3600"})


async def _data(line: WebSocket) -> None:
    await line.accept()
    await line.close()


APP = Starlette(routes=[Route("/", _page), WebSocketRoute("/data", _data), Route("/stop", _page, methods=["POST"])])


@pytest.fixture(scope="module", autouse=True)
def _server() -> Iterator[None]:
    """The guard behind the server that the page has, at a port that is ours."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        AT.append(listening.getsockname()[1])
        config = uvicorn.Config(
            Guard(APP, TOKEN, hosts_of("", 8123)), log_config=None, lifespan="off", ws="websockets-sansio"
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        yield
        server.should_exit = True
        thread.join(10)


AT: list[int] = []
UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": base64.b64encode(bytes(16)).decode(),
}


@dataclass(frozen=True)
class Answer:
    status: int
    headers: HTTPMessage
    text: str


def _answer(method: str, path: str, headers: Mapping[str, str]) -> Answer:
    """Response to a request that is sent byte for byte, with the Host header of the test."""
    connection = HTTPConnection("127.0.0.1", AT[-1], timeout=10)
    connection.putrequest(method, path, skip_host=True)
    for name, value in headers.items():
        connection.putheader(name, value.encode())
    connection.endheaders()
    response = connection.getresponse()
    text = response.read().decode() if response.status != 101 else ""
    connection.close()
    return Answer(response.status, response.headers, text)


def _status(place: str, host: str = OURS, origin: str | None = ORIGIN, query: str = f"token={TOKEN}") -> int:
    """Status that a place answers with; 200 where it lets in."""
    headers: dict[str, str] = {"Host": host, **({} if origin is None else {"Origin": origin})}
    query = quote(query, safe="=&")
    if place == "data":
        status = _answer("GET", f"/data?{query}", {**headers, **UPGRADE}).status
        return 200 if status == 101 else status
    answer = _answer("POST" if place == "stop" else "GET", f"/{place.replace('page', '')}?{query}", headers)
    assert (answer.text == "let in") == (answer.status == 200)
    return answer.status


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("host", [OURS, "localhost:8123", "[::1]:8123", "LOCALHOST:8123"])
def test_a_client_with_host_origin_and_token_gets_in(place: str, host: str) -> None:
    assert _status(place, host, f"http://{host}") == 200


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("host", FOREIGN_HOSTS)
def test_a_foreign_host_is_refused(place: str, host: str) -> None:
    assert _status(place, host) == 400
    assert _status(place, host, f"http://{host}") == 400, "an equal Origin does not help"


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("origin", FOREIGN_ORIGINS)
def test_a_foreign_origin_is_refused(place: str, origin: str) -> None:
    assert _status(place, origin=origin) == 403


@pytest.mark.parametrize("place", ["data", "stop"])
def test_a_missing_origin_is_refused(place: str) -> None:
    assert _status(place, origin=None) == 403


def test_a_person_who_opens_the_address_sends_no_origin() -> None:
    assert _status("page", origin=None) == 200


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("token", WRONG_TOKENS)
def test_a_wrong_token_is_refused(place: str, token: str) -> None:
    assert _status(place, query=f"token={token}") == 403


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    "query", ["", "x=1", f"Token={TOKEN}", f"token={TOKEN}&token={TOKEN}", f"token={TOKEN}&token=x"]
)
def test_a_missing_or_doubled_token_is_refused(place: str, query: str) -> None:
    assert _status(place, query=query) == 403


@pytest.mark.parametrize(("host", "query"), [(OURS, f"token={TOKEN}"), (OURS, "token=x"), ("evil.example", "")])
def test_every_answer_forbids_what_the_page_does_not_need(host: str, query: str) -> None:
    answer = _answer("GET", f"/?{query}", {"Host": host})
    for name, value in HEADERS.items():
        assert answer.headers.get_all(name) == [value]
    policy = HEADERS["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe-eval" not in policy


def test_a_refusal_does_not_give_the_token_away() -> None:
    for query, host in (("", OURS), (f"token={TOKEN}", "evil.example")):
        answer = _answer("GET", f"/?{query}", {"Host": host})
        assert TOKEN not in answer.text + str(answer.headers)


def test_names_of_another_interface_are_ours_only_when_it_is_asked_for() -> None:
    assert "rig.local:80" not in hosts_of("", 80)
    assert {"rig.local:80", "rig.local", "127.0.0.1:80"} <= set(hosts_of("rig.local", 80))
    assert "[fe80::1]:8123" in hosts_of("fe80::1", 8123)


def test_tokens_are_long_and_never_the_same() -> None:
    found = {new_token() for _ in range(100)}
    assert len(found) == 100
    assert min(map(len, found)) >= 43
