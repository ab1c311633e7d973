"""The console's server refuses requests caused by pages of other sites."""

from __future__ import annotations

import http.client
import logging
import socket

import pytest
from websockets.exceptions import InvalidStatus

from bridge.web.serving.console import WebServer
from bridge.web.serving.server import refusal
from tests.peers.browser.page import TestPage
from tests.web.conftest import Desk

OWN = frozenset({"127.0.0.1:8480", "localhost:8480"})


def scope(kind: str = "http", **headers: str) -> dict[str, object]:
    named = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return {"type": kind, "headers": named}


@pytest.mark.parametrize("host", ["127.0.0.1:8480", "localhost:8480", "LOCALHOST:8480"])
def test_own_hosts_are_accepted(host: str) -> None:
    assert not refusal(scope(host=host), OWN)


@pytest.mark.parametrize("host", ["evil.example:8480", "127.0.0.1", "127.0.0.1:80", "localhost:8480.evil.example", ""])
def test_rebound_names_are_refused(host: str) -> None:
    assert "unknown host" in refusal(scope(host=host), OWN)


NAMED = frozenset({"robot.lab", "[fd00::1]"})


@pytest.mark.parametrize("host", ["robot.lab", "robot.lab:8480", "ROBOT.lab:8443", "[fd00::1]", "[FD00::1]:80"])
def test_configured_names_are_hosts_at_any_port(host: str) -> None:
    assert not refusal(scope(host=host), OWN, NAMED)
    assert "web.names" in refusal(scope(host=host), OWN)


@pytest.mark.parametrize("host", ["x.robot.lab", "robot.lab.evil.example:8480", "robot.lab:8480:1", "127.0.0.1:80", ""])
def test_other_names_than_the_configured_ones_are_refused(host: str) -> None:
    assert "unknown host" in refusal(scope(host=host), OWN, NAMED)


PAGES: list[tuple[str, str, str | None, bool]] = [
    ("robot.lab", "http://robot.lab", None, True),
    ("robot.lab", "https://robot.lab", None, True),
    ("robot.lab:443", "https://robot.lab", "https", True),
    ("robot.lab:8443", "https://robot.lab:8443", "https", True),
    ("robot.lab:8443", "https://robot.lab:8443", "wss, http", True),
    ("robot.lab:8443", "http://robot.lab:8443", "https", False),
    ("robot.lab:8443", "https://robot.lab:8443", "http", False),
    ("robot.lab:8443", "https://robot.lab:8443", "ftp", False),
    ("robot.lab", "https://robot.lab:8443", "https", False),
    ("robot.lab:8480", "https://robot.lab:8443", None, False),
    ("robot.lab", "https://evil.example", None, False),
    ("localhost:8480", "https://localhost:8480", "https", False),  # not one of the configured names
]


@pytest.mark.parametrize(("host", "origin", "scheme", "accepted"), PAGES)
@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_a_proxys_page_has_its_name_port_and_scheme(
    kind: str, host: str, origin: str, scheme: str | None, *, accepted: bool
) -> None:
    forwarded = {} if scheme is None else {"x_forwarded_proto": scheme}
    reason = refusal(scope(kind, host=host, origin=origin, **forwarded), OWN, NAMED)
    assert (reason == "") == accepted
    assert accepted or "X-Forwarded-Proto" in reason


def test_with_tls_a_proxy_does_not_change_the_scheme() -> None:
    for origin, accepted in (("https://robot.lab", True), ("http://robot.lab", False)):
        request = {**scope(host="robot.lab", origin=origin, x_forwarded_proto="http"), "scheme": "https"}
        assert (refusal(request, OWN, NAMED) == "") == accepted


def test_paths_are_served_with_and_without_the_prefix(desk: Desk) -> None:
    desk.open_with(web={"prefix": "/lab/robot1/", "names": ["robot.lab"]})
    assert desk.console.server.address == f"http://127.0.0.1:{desk.port}/lab/robot1/"
    for path in ("/", "/lab/robot1/"):
        status, headers, body = ask(desk.port, path, Host="robot.lab")
        assert (status, b"<title>" in body, headers["x-frame-options"]) == (200, True, "DENY")
        assert ask(desk.port, f"{path}app.js")[0] == 200
        with TestPage(desk.port, url=f"ws://127.0.0.1:{desk.port}{path}socket") as page:
            assert page.call("ping")["ok"]
    status, headers, _ = ask(desk.port, "/lab/robot1?x=1")
    assert (status, headers["location"]) == (303, "/lab/robot1/")
    for path in ("/lab/", "/lab/robot10/", "/lab/robot1/lab/robot1/app.js", "/lab/robot1/../../worker.py"):
        assert ask(desk.port, path)[0] == 404, path


def test_a_request_without_exactly_one_host_is_refused() -> None:
    assert refusal({"type": "http", "headers": [(b"host", b"localhost:8480")] * 2}, OWN)
    assert refusal({"type": "http", "headers": []}, OWN)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://localhost:8480", "http://localhost:8481"])
@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_pages_of_other_origins_are_refused(kind: str, origin: str) -> None:
    assert refusal(scope(kind, host="localhost:8480", origin=origin), OWN)
    assert not refusal(scope(kind, host="localhost:8480", origin="http://localhost:8480"), OWN)


def test_another_sites_request_is_refused() -> None:
    assert refusal(scope(host="localhost:8480", sec_fetch_site="cross-site"), OWN)
    assert not refusal(scope(host="localhost:8480", sec_fetch_site="same-origin"), OWN)


def test_a_browsers_socket_needs_an_origin() -> None:
    assert refusal(scope("websocket", host="localhost:8480", user_agent="Mozilla/5.0"), OWN)
    assert not refusal(scope("websocket", host="localhost:8480", user_agent="Python"), OWN)


def ask(port: int, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    try:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
    finally:
        connection.close()


def test_the_page_is_served_with_a_strict_policy(desk: Desk) -> None:
    status, headers, body = ask(desk.port, "/")
    assert status == 200
    assert b"<title>" in body
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert ask(desk.port, "/app.js")[0] == 200


@pytest.mark.parametrize("path", ["/../worker.py", "/%2e%2e/worker.py", "/..%2fworker.py", "/map/none.png", "/none"])
def test_other_paths_are_not_found(desk: Desk, path: str) -> None:
    status, headers, body = ask(desk.port, path)
    assert status == 404
    assert b"import" not in body
    assert "content-security-policy" in headers


def test_unknown_hosts_are_refused(desk: Desk) -> None:
    status, _, body = ask(desk.port, "/", Host=f"evil.example:{desk.port}")
    assert status == 403
    assert b"unknown host" in body


def test_clients_cannot_forge_their_address(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "midspan.web"):
        ask(desk.port, "/", **{"Host": "evil.example", "X-Forwarded-For": "10.9.8.7"})
    assert "refused a request from 127.0.0.1" in caplog.text


def test_foreign_pages_get_no_socket(desk: Desk) -> None:
    for options in ({"origin": "http://evil.example"}, {"additional_headers": {"Sec-Fetch-Site": "cross-site"}}):
        with pytest.raises(InvalidStatus):
            TestPage(desk.port, **options)
    assert desk.console.server.pages == 0


def test_an_address_in_use_is_reported(desk: Desk) -> None:
    with pytest.raises(RuntimeError, match=rf"cannot listen on 127.0.0.1:{desk.port}: .*in use; set web.listen"):
        WebServer(f"127.0.0.1:{desk.port}", None, (), None, None)  # type: ignore[arg-type]


def test_incomplete_requests_do_not_block_others(desk: Desk) -> None:
    open_ = [socket.create_connection(("127.0.0.1", desk.port)) for _ in range(20)]
    try:
        for sock in open_:
            sock.sendall(b"GET / HTTP/1.1\r\nHost: ")
        assert ask(desk.port, "/")[0] == 200
    finally:
        for sock in open_:
            sock.close()
