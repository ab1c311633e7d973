"""Access to the Foxglove server: which clients and pages may connect, and with which role."""

from __future__ import annotations

import contextlib
import logging
import socket
import ssl
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from websockets.exceptions import InvalidStatus

from bridge.config.model import Config
from bridge.foxglove import front
from bridge.foxglove.front import RequestHead, TurnedAwayError
from bridge.foxglove.section import FoxgloveSection
from bridge.foxglove.visitors import MARK
from bridge.foxglove.worker import Live, SdkLog
from bridge.hub.security.certificates import Authority
from bridge.hub.security.tokens import new_token
from tests.foxglove.conftest import Desk
from tests.foxglove.test_channels import cdr
from tests.foxglove.test_publishing import DRIVE, wait_for_status
from tests.peers.browser.foxglove_app import App
from tests.support.wait import until

ANNA, HALL = new_token(), new_token()
TOKENS = {"anna": {"role": "drive", "sha256": ANNA[1]}, "hall": {"role": "watch", "sha256": HALL[1]}}
FIREFOX = "Mozilla/5.0 (X11; Linux x86_64; rv:140.0) Gecko/20100101 Firefox/140.0"


class GuardedDesk(Desk):
    """A server with TLS, tokens and its own keys."""

    def __init__(self, folder: Path) -> None:
        self.keys = folder / "keys"
        authority = Authority(self.keys)
        authority.make()
        authority.issue("here", ["127.0.0.1"])
        super().__init__(folder)

    def open(self, **sections: Any) -> Live:
        hub = {"listen": self.hubs.endpoint, "open": {"keys": self.keys}}
        return super().open(hub=hub, foxglove={"tokens": TOKENS}, **sections)

    def app(self, **options: Any) -> App:
        return super().app(ssl=ssl.create_default_context(cafile=self.keys / "ca.pem"), **options)


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[GuardedDesk]:
    desk_ = GuardedDesk(tmp_path)
    yield desk_
    desk_.close()


def status_of(desk: Desk, **options: Any) -> int:
    """Return the HTTP status of a refusal."""
    with pytest.raises(InvalidStatus) as refused:
        desk.app(**options)
    return refused.value.response.status_code


def test_the_server_is_disabled_and_local_by_default() -> None:
    section = Config().section(FoxgloveSection)
    assert (section.enabled, section.listen, section.drive, section.guarded) == (False, "127.0.0.1:8765", False, False)


@pytest.mark.parametrize(
    ("section", "reason"),
    [
        ({"listen": "0.0.0.0:8765"}, r"other machines reach 0\.0\.0\.0, so it would be open to anyone"),
        ({"listen": "0.0.0.0:8765", "drive": True}, "set foxglove.tokens"),
        ({"listen": "robot1:8765"}, "reach it by a tunnel"),
        ({"listen": "[::]:8765"}, "other machines reach ::"),
        ({"listen": "8765"}, "is not an address with a port"),
        ({"drive": True, "tokens": TOKENS}, "the roles of the tokens decide who may drive"),
        ({"tokens": {"anna": {"role": "root", "sha256": ANNA[1]}}}, "watch"),
    ],
)
def test_unsafe_configurations_are_refused(section: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValidationError, match=reason):
        FoxgloveSection.model_validate(section)


def test_foreign_pages_may_not_connect(desk: Desk) -> None:
    assert status_of(desk, origin="https://evil.example") == 403
    assert status_of(desk, origin="null") == 403
    assert status_of(desk, origin=f"http://127.0.0.1:{desk.live.front.port}") == 403
    assert status_of(desk, user_agent_header=FIREFOX) == 403
    for options in ({"origin": "https://app.foxglove.dev", "user_agent_header": FIREFOX}, {"origin": "file://"}, {}):
        with desk.app(**options) as app:
            app.until(lambda: app.texts, "the client is accepted")
    desk.open_with(foxglove={"origins": ["https://fox.example"]})
    assert status_of(desk, origin="https://app.foxglove.dev") == 403
    with desk.app(origin="https://Fox.example") as app:
        app.until(lambda: app.texts, "the client is accepted")


def test_tokens_determine_name_and_role(guarded: GuardedDesk) -> None:
    subscription = guarded.far.subscribe("/said", "std_msgs/String")
    with (
        guarded.app(query=f"?token={ANNA[0]}", origin="https://fox.example") as anna,
        guarded.app(additional_headers={"Authorization": f"Bearer {HALL[0]}"}) as hall,
    ):
        for app in (anna, hall):
            number = app.advertise("/said", "std_msgs/msg/String", "json")
            app.publish(number, b'{"data": "of %d"}' % (app is anna))
        wait_for_status(hall, "you may watch, but not publish")
        until(lambda: guarded.far.publishers("/said"), "anna publishes")
        anna.publish(number, b'{"data": "of anna"}')
        assert guarded.far.wait(subscription, 1)[-1]["data"].startswith("of ")
        status = guarded.status()
        assert [(client["who"], client["role"]) for client in status["clients"]] == [
            ("anna at 127.0.0.1", "drive"), ("hall at 127.0.0.1", "watch"),
        ]  # fmt: skip
        assert status["text"].startswith(f"wss://127.0.0.1:{guarded.live.front.port}, 2 clients")
    until(lambda: guarded.status()["clients"] == [], "the clients are disconnected")


def test_clients_without_a_valid_token_are_refused(
    guarded: GuardedDesk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("bridge.web.serving.access.FIRST_WAIT", 60.0)
    assert [status_of(guarded), status_of(guarded)] == [401, 401]
    assert status_of(guarded, query=f"?token={HALL[1]}") == 401, "the hash is not accepted as a token"
    assert status_of(guarded, query="?token=old", user_agent_header="studio") == 401
    for _ in range(3):
        with pytest.raises(InvalidStatus) as refused:
            guarded.app(query="?token=old", user_agent_header="studio")
        assert refused.value.response.status_code == 429
        assert 0 < int(refused.value.response.headers["Retry-After"]) <= 60
    with guarded.app(query=f"?token={HALL[0]}") as app:
        app.until(lambda: app.texts, "a valid token is accepted")
    lines = [record.getMessage() for record in caplog.records if "foxglove.tokens" in record.getMessage()]
    assert lines.count("127.0.0.1 (program 'studio') sent a token that is not in foxglove.tokens") == 1


def test_a_client_that_bypasses_the_front_may_not_publish(desk: Desk) -> None:
    desk.open_with(**DRIVE)
    host, port = desk.live.front.inner
    assert not host.startswith("127.0.0.")
    with contextlib.closing(App(port, host=host)) as app:
        app.send(op="advertise", channels=[{"id": MARK, "topic": "a" * 32, "encoding": "json", "schemaName": ""}])
        app.advertise("/said", "std_msgs/msg/String", "json")
        wait_for_status(app, "you may watch, but not publish")
        assert not desk.far.publishers("/said")


def test_a_client_cannot_use_a_secret_a_second_time(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.open_with(**DRIVE)
    visitors, recorded = desk.live.visitors, list[tuple[int, str]]()
    identify = visitors.identify

    def record(client: int, secret: str) -> None:
        identify(client, secret)
        recorded.append((client, secret))

    monkeypatch.setattr(visitors, "identify", record)
    with desk.app() as app:
        app.until(lambda: app.texts, "the client is accepted")
        ((client, secret),) = until(lambda: recorded, "the secret was used")
        identify(99, secret)
        assert visitors.visitor_of(99) is None
        assert visitors.all() == [visitors.visitor_of(client)]


@pytest.mark.parametrize(
    "head",
    [
        b"GET / HTTP/1.0\r\n\r\n", b"POST / HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\nno header\r\n\r\n", b"\r\n\r\n",
        b"GET / HTTP/1.1\r\n folded: x\r\n\r\n", b"GET  HTTP/1.1\r\n\r\n", b"\xff\xfe\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: x\nOrigin: y\r\n\r\n", b"GET / HTTP/1.1\r\nHost: x\0\r\n\r\n",
    ],
)  # fmt: skip
def test_invalid_heads_are_refused(head: bytes) -> None:
    with pytest.raises(TurnedAwayError):
        RequestHead.read(head)


def test_a_head_is_forwarded_without_its_secrets() -> None:
    request = RequestHead.read(
        b"GET /?token=a%20b HTTP/1.1\r\nHost: x\r\nCookie: c\r\nUpgrade: websocket\r\nX: 1\r\nx: 2\r\n\r\n"
    )
    assert request.token == "a b"
    assert RequestHead.read(b"GET //[x?token=t HTTP/1.1\r\n\r\n").token == "t"
    assert request.forwarded() == b"GET / HTTP/1.1\r\nhost: x\r\nupgrade: websocket\r\nx: 1,2\r\n\r\n"
    assert RequestHead.read(b"GET / HTTP/1.1\r\nAuthorization: Bearer t\r\n\r\n").token == "t"


def raw(desk: Desk, data: bytes) -> bytes:
    """Send bytes, and return everything received until the connection ends."""
    with socket.create_connection(("127.0.0.1", desk.live.front.port), timeout=10) as peer:
        received = b""
        with contextlib.suppress(ConnectionError):
            peer.sendall(data)
            while part := peer.recv(4096):
                received += part
    return received


def test_other_protocols_are_refused_and_disconnected(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    assert raw(desk, b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n").startswith(b"HTTP/1.1 400 Bad Request\r\n")
    old = b"GET / HTTP/1.1\r\nUpgrade: websocket\r\nSec-WebSocket-Protocol: foxglove.websocket.v1\r\n\r\n"
    assert b"subprotocol foxglove.sdk.v1" in raw(desk, old)
    assert b"for the Foxglove app" in raw(desk, b"HELO robot\r\n\r\n")
    assert raw(desk, b"GET /" + b"x" * 100_000) == b""
    with monkeypatch.context() as patch:
        patch.setattr(front, "HEAD_SECONDS", 0.2)
        assert raw(desk, b"GET / HTTP/1.1\r\n") == b"", "an incomplete request is disconnected"
    with desk.app() as app:
        app.until(lambda: app.texts, "other clients are served")


def test_the_number_of_clients_is_limited(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(front, "MOST_CLIENTS", 2)
    with desk.app(), desk.app() as app:
        assert status_of(desk) == 503
        app.until(lambda: app.texts, "other clients are served")
    until(lambda: not desk.status()["clients"], "the clients are disconnected")
    with desk.app() as app:
        app.until(lambda: app.texts, "new clients are accepted again")


def test_a_client_that_reads_nothing_is_disconnected_and_does_not_delay_others(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(front, "FULL_BUFFER_SECONDS", 2.0)
    monkeypatch.setattr(front, "MOST_UNREAD", 1 << 20)
    publisher = desk.publisher("/flood", "std_msgs/String")
    secret = cdr("x" * 500_000)
    with desk.app() as app, desk.app(max_queue=1, close_timeout=0.1) as deaf:
        deaf.subscribe("/flood")
        # wait, because a client that no longer reads does not repeat a refused subscription
        deaf.until(publisher.matched, "the topic is subscribed")
        app.subscribe("/flood")
        app.sync()
        shares: list[int] = []

        def cut() -> bool:
            before = len(app.messages["/flood"])
            for _ in range(4):
                publisher.put(secret)
                app.read(0.2)
            shares.append(len(app.messages["/flood"]) - before)
            return len(desk.status()["clients"]) == 1

        until(cut, "the client that does not read is disconnected", 30)
        wait_for_status = desk.status()
        assert sum(shares) >= 2 * len(shares), (
            f"while one client reads nothing the other receives {shares} of 4 each: {wait_for_status}"
        )
        (left,) = app.messages["/flood"][-1:]
        assert left[1] == secret


def test_a_client_whose_machine_vanishes_is_noticed(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the SDK nor the app sends pings, and a client that watches nothing receives no data."""
    accepted: list[Any] = []
    keep_alive = front.keep_alive
    monkeypatch.setattr(front, "keep_alive", lambda sock: (accepted.append(sock), keep_alive(sock)))
    with desk.app() as app:
        app.sync()
        (sock,) = accepted
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)


def test_an_address_in_use_is_reported(desk: Desk) -> None:
    with pytest.raises(RuntimeError, match=r"cannot listen on 127\.0\.0\.1:\d+: .*; set foxglove\.listen"):
        desk.open(foxglove={"listen": f"127.0.0.1:{desk.live.front.port}"})


def test_the_sdks_log_of_clients_is_rate_limited(caplog: pytest.LogCaptureFixture) -> None:
    logger = logging.getLogger("foxglove")
    before = logger.handlers, logger.propagate
    try:
        SdkLog.install()
        with caplog.at_level(logging.WARNING):
            for number in range(200):
                logging.getLogger("foxglove.websocket").error("bad frame %d", number)
    finally:
        logger.handlers, logger.propagate = before
    recorded = [record.getMessage() for record in caplog.records if record.name == "midspan.foxglove"]
    assert recorded[0] == "the SDK: bad frame 0"
    assert len(recorded) == 20
