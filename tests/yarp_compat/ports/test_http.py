"""HTTP requests to a port."""

from __future__ import annotations

import json
import socket
import urllib.error
import urllib.request

import pytest

from tests.support.wait import until
from tests.yarp_compat.ports.conftest import MakePort
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.port import PortCore
from yarp_compat.wire import carriers
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.profile import Profile


def fetch(port: PortCore, path: str, data: bytes | None = None, **headers: str) -> tuple[str, str]:
    """Return a page's content type and text."""
    request = urllib.request.Request(f"http://{port.contact.host}:{port.contact.port}{path}", data, headers)
    with urllib.request.urlopen(request, timeout=10) as page:
        return page.headers["Content-Type"], page.read().decode()


def echo(message: PortMessage) -> None:
    message.reply(encode(["got", decode(message.payload)], Profile.YARP3))


def test_a_browser_gets_a_page_about_the_port(make_port: MakePort) -> None:
    port = make_port("/r")
    make_port("/w").add_output("/r")
    kind, page = fetch(port, "/")
    assert kind.startswith("text/html")
    assert "yarp port /r" in page
    assert "There is an input connection from /w to /r using tcp" in page


@pytest.mark.parametrize("path", ["/data=hello+1", "/?data=hello%201", "/hello/1"])
def test_a_browser_sends_a_message(make_port: MakePort, path: str) -> None:
    assert "got (hello 1)" in fetch(make_port("/r", echo), path)[1]


def test_a_form_sends_a_message(make_port: MakePort) -> None:
    assert "got (hello 1)" in fetch(make_port("/r", echo), "/form", b"data=hello+1")[1]


def test_a_request_from_http_gets_json(make_port: MakePort) -> None:
    got: list[object] = []

    def ports(message: PortMessage) -> None:
        got.append(decode(message.payload))
        entry = ["port", ["name", "/a"], ["port_number", 10002]]
        message.reply(encode(["ports", entry, ["port", ["name", "/b"]]], Profile.YARP3))

    port = make_port("/r", ports)
    kind, text = fetch(port, "/?req=list&format=json")
    assert kind == "text/json"
    assert json.loads(text) == [
        "ports",
        {"type": "port", "name": "/a", "port_number": 10002},
        {"type": "port", "name": "/b"},
    ]
    assert got == [["list", ["REQUEST_URI", "/?req=list&format=json"], ["format", "json"], ["req", "list"]]]


def test_the_owner_of_a_port_serves_pages(make_port: MakePort) -> None:
    port = make_port("/r", lambda m: m.reply(encode(["web", "h1 {}", "mime", "text/css"], Profile.YARP3)))
    assert fetch(port, "/web/main.css") == ("text/css", "h1 {}")


def test_registration_lines_are_links(make_port: MakePort) -> None:
    line = b"registration name /a ip 127.0.0.1 port 10002 type tcp\r\n*** end of message\r\n"
    port = make_port("/r", lambda m: m.reply(line, plain=True))
    assert '<a href="http://127.0.0.1:10002/">/a</a>' in fetch(port, "/data=list")[1]


def test_message_text_is_escaped(make_port: MakePort) -> None:
    port = make_port("/r", lambda m: m.reply(m.payload))
    page = fetch(port, "/?data=%22%3Cscript%3Ealert(1)%3C/script%3E%22")[1]
    assert "<script>" not in page
    assert "&lt;script&gt;" in page


def test_a_browser_sends_an_administrative_command(make_port: MakePort) -> None:
    assert "[ver] 1 2 3" in fetch(make_port("/r"), "/?admin=%5Bver%5D")[1]


def test_cross_site_requests_are_refused(make_port: MakePort) -> None:
    """Otherwise, a foreign page could send commands with the access rights of the user who views it."""
    port = make_port("/r", echo)
    for headers in ({"Origin": "http://elsewhere"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            fetch(port, "/?data=go", **headers)
    assert port.counters.received == 0
    origin = f"http://{port.contact.host}:{port.contact.port}"
    assert "got" in fetch(port, "/form", b"data=go", Origin=origin)[1]


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (b"GET /" + b"a" * 20000 + b" HTTP/1.1\r\n\r\n", b""),
        (b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 5000 + b"\r\n", b"431"),
        (b"GET /? HTTP/1.1\r\nContent-Length: -1\r\n\r\n", b"400"),
        (b"POST /form HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n", b"400"),
        (b"POST /form HTTP/1.1\r\nContent-Length: 000000000099999999999\r\n\r\n", b"400"),
        (b"POST /form HTTP/1.1\r\nContent-Length: " + b"0" * 5000 + b"\r\n\r\n", b"200"),
        (b"GET /?" + b"a&" * 200 + b" HTTP/1.1\r\n\r\n", b"400"),
        (b"GET /data=" + b"(" * 9000 + b" HTTP/1.1\r\n\r\n", b"400"),
        (b"GET /\r\n\r\n", b"200"),
        (b"GET /favicon.ico HTTP/1.1\r\n\r\n", b"404"),
    ],
)
def test_invalid_requests_close_the_connection(make_port: MakePort, data: bytes, status: bytes) -> None:
    port = make_port("/r", echo)
    with socket.create_connection((port.contact.host, port.contact.port)) as sock:
        sock.settimeout(10)
        sock.sendall(data)
        answer = b""
        try:
            while part := sock.recv(4096):
                answer += part
        except ConnectionResetError:
            pass
    if status:
        assert answer.startswith(b"HTTP/1.1 " + status)
    else:
        assert answer == b""
    until(lambda: not port.inputs(), "the connection is closed")


def test_browser_reads_a_port(make_port: MakePort) -> None:
    """The port's messages are streamed as lines until it closes."""
    port = make_port("/w")
    with socket.create_connection((port.contact.host, port.contact.port)) as sock:
        sock.settimeout(10)
        sock.sendall(b"GET /r HTTP/1.1\r\nHost: x\r\n\r\n")
        until(port.outputs, "the browser is an output")
        assert port.connections.outputs[0].carrier is carriers.HTTP
        for i in range(3):
            port.write(encode(["a", i], Profile.YARP3), strict=True)
        assert port.wait_writes(10)
        port.close()
        received = b""
        while part := sock.recv(4096):
            received += part
    head, _, body = received.partition(b"\r\n\r\n")
    assert b"chunked" in head
    assert body == b"5\r\na 0\r\n\r\n5\r\na 1\r\n\r\n5\r\na 2\r\n\r\n0\r\n\r\n"
