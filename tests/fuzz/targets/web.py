"""The console: requests and frames from any client of its port, to a real worker on a real hub."""

from __future__ import annotations

import atexit
from typing import TYPE_CHECKING

from tests.fuzz.target import JSON_WORDS, Subject, Target, scratch, texts

if TYPE_CHECKING:
    from tests.peers.browser.hostile import HostileConsole

_CUT = b"\x1e"
_HOST = b"HOST"


def _web() -> Subject:
    """Up to 40 requests or frames; the console survives them, and no robot drives unless a page holds the control."""
    from tests.peers.browser.hostile import HostileConsole

    console = HostileConsole(scratch())
    atexit.register(console.close)
    return Subject(lambda data: give(console, data), [*requests(), *conversations()], (), WORDS, largest=6000)


def give(console: HostileConsole, data: bytes) -> None:
    """Send one input to the console."""
    kind, *pieces = data.replace(_HOST, console.host.encode()).split(_CUT)[:41]
    if kind[:1] == b"H":
        console.ask(pieces)
    else:
        console.converse(pieces)


def requests() -> list[bytes]:
    """Return valid requests, and some that are rejected."""
    head = "HTTP/1.1\r\nHost: HOST\r\n"
    some = (
        f"GET / {head}\r\n",
        f"GET /app.js {head}If-None-Match: x\r\nRange: bytes=0-5\r\n\r\n",
        f"HEAD /map/occupancy.png?v=1 {head}\r\n",
        f'POST /login {head}Content-Length: 12\r\nContent-Type: application/json\r\n\r\n{{"token":1}}',
        f"PUT /%2e%2e/worker.py {head}Transfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n0\r\n\r\n",
        f"OPTIONS * {head}Origin: http://HOST\r\n\r\n",
        "GET / HTTP/1.0\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: evil.example\r\nOrigin: http://evil.example\r\n\r\n",
        (
            f"GET /socket {head}Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: midspan.console.1\r\n\r\n"
        ),
        (
            f"GET /socket {head}Origin: http://evil.example\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
        ),
        f"GET / {head}Cookie: midspan=x\r\n\r\nGET /style.css {head}\r\n",
        f"GET / {head}X: {'y' * 3000}",
        f"GET /socket {head}\r\n",
        f"GET /{'a/' * 500} {head}\r\n",
    )
    return [
        b"H" + _CUT + _CUT.join(texts(*some)),
        *(b"H" + _CUT + _CUT.join(texts(*part)) for part in (some[:4], some[4:9])),
    ]


def conversations() -> list[bytes]:
    """Return valid frames of a page, and some that are rejected."""
    call = 't{"op": "call", "id": 1, "verb": "%s", "args": {%s}}'
    pose = '"x": 1.0, "y": 2.0, "theta": 0.5'
    talks = (
        ('t{"op": "watch", "feed": "robot"}', 't{"op": "watch", "feed": "topic:/cmd_vel"}',
         't{"op": "took", "feed": "robot", "n": 1}', 't{"op": "unwatch", "feed": "robot"}'),
        *((f't{{"op": "watch", "feed": "{name}"}}', f't{{"op": "took", "feed": "{name}", "n": 1}}')
          for name in ("laser", "path", "driving", "map", "places", "maps", "status", "topics", "frames")),
        ('t{"op": "hold", "x": 0.2, "y": 0.0, "turn": 0.1}', 't{"op": "hold", "x": 50, "y": -1, "turn": 9}',
         't{"op": "release"}'),
        (call % ("ping", ""), call % ("explain", '"name": "/scan"'), call % ("goto", pose), call % ("set_pose", pose)),
        (call % ("keep_place", f'"name": "a", {pose}'), call % ("delete_place", '"name": "a"')),
        (call % ("patrol", '"places": ["a", "b"], "wait": 3'),
         call % ("rename_place", '"name": "a", "to": "b", "kind": "area"')),
        (call % ("keep_area", '"name": "a", "points": [[0, 0], [1, 0.5], [1, 1]], "replace": true'),
         call % ("paint_flags", '"map": "a", "size": [9, 9], "runs": [[0, 1, 2, 4], [1, 1, 2, null, 3]]')),
        (call % ("log", '"after": 3, "level": "info", "worker": "web", "text": "a b"'), call % ("config", ""),
         't{"op": "watch", "feed": "log"}', 't{"op": "watch", "feed": "image:160:/camera@sensor_msgs/msg/Image"}'),
        (call % ("doctor", ""), 't{"op": "watch", "feed": "patrol"}', 't{"op": "watch", "feed": "robots"}'),
        (call % ("goto_place", '"name": "a"'), call % ("choose_planner", '"name": "nav2"')),
        (call % ("stop", ""), call % ("pause", ""), call % ("resume", ""), call % ("halt", "")),
        ('m\x40{"op": "watch", "feed": "topic:/t"}', 'm\x7f{"op": "call", "id": 2, "verb": "ping"}'),
        ('m\x7f{"op": "hold", "x": 0.1, "y": 0.0, "turn": 0.0}', 'm\x20{"op": "nothing"}'),
        ('s{"op": "wat', 'nch", "feed": ', "pinside", 'e"robot"}', "bbytes", "p", "oalone", "c\x03\xe8"),
        ("r\x01\x80\x00\x00\x00\x00", "r\x0f\x7f", "t{"),
    )  # fmt: skip
    return [b"W" + _CUT + _CUT.join(texts(*talk)) for talk in talks]


WORDS = [
    *JSON_WORDS, _CUT, _CUT + b"t", _CUT + b"m\x7f", _HOST,
    *texts(
        '"op": ', '"watch"', '"hold"', '"call"', '"took"', '"feed": ', '"verb": ', '"args": ', '"id": ', '"n": ',
        '"x": ', '"topic:/', '"topic:/**', "Infinity", "\r\n", "\r\n\r\n", "Host: ", "Host: localhost",
        "Origin: ", "Origin: null\r\n", "Content-Length: ", "Transfer-Encoding: chunked\r\n",
        "Expect: 100-continue\r\n",
        "Upgrade: websocket\r\nConnection: Upgrade\r\n", "Sec-Fetch-Site: cross-site\r\n", "Range: bytes=", "%00", "..",
        "%2e%2e%2f", "GET ", "CONNECT ", "POST ", " HTTP/1.1", " HTTP/9.9", "ffffffff\r\n", "\x00", "Cookie: ",
        "Authorization: Bearer ", "X: " + "y" * 5000,
    ),
]  # fmt: skip


TARGETS = (Target("web", 7_000, _web),)
