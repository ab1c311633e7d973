"""The Foxglove server: request heads from any client of its port."""

from __future__ import annotations

from tests.fuzz.target import Subject, Target, texts


def _heads() -> Subject:
    """A forwarded head is valid again, with the same headers except the secrets."""
    from bridge.foxglove.front import RequestHead, TurnedAwayError

    def parse(data: bytes) -> None:
        request = RequestHead.read(data)
        assert isinstance(request.token, str)
        again = RequestHead.read(request.forwarded())
        kept = {name: value for name, value in request.headers.items() if name not in ("authorization", "cookie")}
        assert (again.target, again.headers) == ("/", kept)

    head = (
        "Host: robot1:8765\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n"
    )
    seeds = texts(
        f"GET / HTTP/1.1\r\n{head}Origin: https://app.foxglove.dev\r\n\r\n",
        f"GET /?token=abc%20d&x=1 HTTP/1.1\r\n{head}Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n",
        f"GET / HTTP/1.1\r\n{head}Authorization: Bearer abc\r\nCookie: a=b\r\nX: 1\r\nx: 2\r\n\r\n",
    )
    tokens = texts("\r\n", "\n", ": ", "?token=", "%0d%0a", "Authorization: ", " HTTP/1.1", "\x00", "\x85", "[", "//[x")
    return Subject(parse, seeds, (TurnedAwayError,), tokens, largest=20_000)


TARGETS = (Target("foxglove", 10_000, _heads),)
