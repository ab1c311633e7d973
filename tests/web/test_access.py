"""Access to a console that other machines reach: authentication, and what each role may do."""

from __future__ import annotations

import http.client
import json
import logging
import ssl
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from websockets.exceptions import InvalidStatus, WebSocketException

from bridge.config.sections.listen import TokenSection
from bridge.hub.security.certificates import Authority
from bridge.hub.security.tokens import new_token
from bridge.web.section import WebSection
from bridge.web.serving import access
from bridge.web.serving.access import COOKIE, Access, Grant, WrongTokens, sender, stored_secret
from bridge.web.serving.scarce_log import ScarceLog
from bridge.web.serving.server import hosts
from bridge.worker import WorkerFailedError
from tests.peers.browser.page import TestPage
from tests.support.wait import until
from tests.web.conftest import Desk
from tests.web.test_bounds import connect, is_closed
from tests.web.test_hold import Base, hold
from tests.web.test_server import ask

DRIVE, WATCH = new_token(), new_token()
TOKENS = {"anna": {"role": "drive", "sha256": DRIVE[1]}, "hall": {"role": "watch", "sha256": WATCH[1]}}


class GuardedDesk(Desk):
    """A console with TLS, tokens and its own keys."""

    def __init__(self, folder: Path, keys: Path) -> None:
        self.keys = keys
        authority = Authority(keys)
        authority.make()
        authority.issue("here", ["127.0.0.1", "robot.test"])
        for name in ("operator1", "guest"):
            authority.issue(name)
        super().__init__(folder)

    def open(self, **sections: Any) -> Any:
        hub = {"listen": self.hubs.endpoint, "open": {"keys": self.keys}}
        return super().open(hub=hub, web={"tokens": TOKENS, "trusted": ["operator1"], **sections.get("web", {})})

    def tls(self, name: str = "") -> ssl.SSLContext:
        """Return the TLS context of a peer with this name; "" means a peer without a certificate."""
        context = ssl.create_default_context(cafile=self.keys / "ca.pem")
        if name:
            context.load_cert_chain(self.keys / f"{name}.pem", self.keys / f"{name}.key")
        return context

    def ask(
        self, method: str, path: str, body: str = "", name: str = "", **headers: str
    ) -> tuple[int, dict[str, str], str]:
        """Return the response to a request."""
        connection = http.client.HTTPSConnection("127.0.0.1", self.port, timeout=10, context=self.tls(name))
        try:
            connection.request(method, path, body or None, {k.replace("_", "-"): v for k, v in headers.items()})
            answer = connection.getresponse()
            return answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read().decode()
        finally:
            connection.close()

    def login(self, token: str, **headers: str) -> tuple[int, dict[str, str], str]:
        """Log in like the page."""
        all_headers = {"Origin": f"https://127.0.0.1:{self.port}", **headers}
        return self.ask("POST", "/login", json.dumps({"token": token}), **all_headers)

    def page(self, token: str = "", name: str = "", **headers: str) -> TestPage:
        """Open a page with a token or a certificate."""
        if token:
            headers["Authorization"] = f"Bearer {token}"
        return TestPage(self.port, ssl=self.tls(name), additional_headers=headers)


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[GuardedDesk]:
    desk = GuardedDesk(tmp_path, tmp_path / "keys")
    yield desk
    desk.close()


def test_a_public_address_needs_tls_and_a_login() -> None:
    assert not WebSection().guarded
    with pytest.raises(ValidationError, match=r"other machines reach 0\.0\.0\.0, but it has no login"):
        WebSection(listen="0.0.0.0:8480")
    for more in ({"tokens": TOKENS}, {"trusted": ["operator1"]}):
        for listen in ("0.0.0.0:8480", "127.0.0.1:8480", "[::]:8480"):
            assert WebSection.model_validate({"listen": listen, **more}).guarded


@pytest.mark.parametrize(
    "invalid",
    [{"prefix": "robot1"}, {"prefix": "/a b"}, {"prefix": "/../x"}, {"prefix": "/map"}, {"prefix": "/login/x"},
     {"tokens": {"a b": TOKENS["anna"]}}, {"tokens": {"a": {"role": "root", "sha256": DRIVE[1]}}},
     {"tokens": {"a": {"role": "drive", "sha256": DRIVE[0]}}}, {"names": ["http://robot"]}, {"names": ["robot:80"]}],
)  # fmt: skip
def test_invalid_settings_are_refused(invalid: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        WebSection.model_validate(invalid)


@pytest.mark.parametrize(("prefix", "used"), [("", ""), ("/", ""), ("/a", "/a"), ("/a/b.c-d_e/", "/a/b.c-d_e")])
def test_a_prefix_has_no_slash_at_its_end(prefix: str, used: str) -> None:
    assert WebSection.model_validate({"prefix": prefix}).prefix == used


def test_a_login_below_a_prefix_has_its_own_cookie(guarded: GuardedDesk) -> None:
    guarded.open_with(web={"prefix": "/robot1"})
    assert guarded.ask("GET", "/robot1/")[1]["location"] == "/robot1/login"
    cookie = guarded.login(DRIVE[0])[1]["set-cookie"].partition(";")[0]
    assert cookie.startswith("__Host-midspan~robot1=anna.")
    assert guarded.ask("GET", "/robot1/whoami", Cookie=f"{COOKIE}=other; {cookie}")[0] == 200
    assert guarded.ask("GET", "/robot1/whoami", Cookie=cookie.replace("robot1", "robot2"))[0] == 401


def test_an_unauthenticated_client_gets_only_the_login(guarded: GuardedDesk) -> None:
    status, headers, _ = guarded.ask("GET", "/")
    assert (status, headers["location"]) == (303, "/login")
    status, headers, body = guarded.ask("GET", "/login")
    assert status == 200
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "Your token" in body
    for path in ("/login/login.js", "/login/login.css", "/style.css", "/icon.svg"):
        assert guarded.ask("GET", path)[0] == 200
    files = ("/index.html", "/app.js", "/views/drive/view.js", "/lib/dom.js", "/login/login.html", "/map/occupancy.png")
    for path in (*files, "/whoami", "/none", "//login", "/login/../app.js"):
        status, _, body = guarded.ask("GET", path)
        assert status == 401, path
        assert "login required" in body
    with pytest.raises(InvalidStatus, match="401"):
        guarded.page()


def test_a_login_sets_a_cookie(guarded: GuardedDesk) -> None:
    status, headers, body = guarded.login(DRIVE[0])
    assert (status, json.loads(body)) == (200, {"name": "anna", "role": "drive"})
    cookie, *attributes = headers["set-cookie"].split("; ")
    assert cookie.startswith(f"{COOKIE}=anna.")
    assert DRIVE[0] not in cookie
    assert {"HttpOnly", "Secure", "SameSite=strict", "Path=/"} <= set(attributes)
    assert not any(attribute.lower().startswith("domain") for attribute in attributes)
    assert guarded.ask("GET", "/", Cookie=f"x=1; {cookie}")[0] == 200
    with guarded.page(Cookie=cookie) as page:
        page.until(lambda: page.others, "the hello arrives")
        assert (page.others[0]["role"], page.others[0]["who"]) == ("drive", "anna")
    guarded.open_with()
    assert json.loads(guarded.ask("GET", "/whoami", Cookie=cookie)[2])["name"] == "anna", "the login survives a restart"
    for invalid in (f"{COOKIE}=hall{cookie[len(COOKIE) + 5 :]}", cookie[:-1] + ("0" if cookie[-1] != "0" else "1")):
        assert guarded.ask("GET", "/whoami", Cookie=invalid)[0] == 401
    assert (
        "Max-Age=0"
        in guarded.ask("POST", "/logout", Origin=f"https://127.0.0.1:{guarded.port}", Cookie=cookie)[1]["set-cookie"]
    )


@pytest.mark.parametrize(
    ("body", "status"),
    [("", 400), ("[]", 400), ('{"token": 1}', 400), ("[" * 900, 400), ('{"token": "' + "x" * 2000 + '"}', 400),
     ('{"token": "\\ud800"}', 403), ('{"token": ""}', 403)],
)  # fmt: skip
def test_invalid_logins_are_refused(guarded: GuardedDesk, body: str, status: int) -> None:
    origin = f"https://127.0.0.1:{guarded.port}"
    assert guarded.ask("POST", "/login", body, Origin=origin)[0] == status
    assert guarded.ask("POST", "/login", json.dumps({"token": DRIVE[0]}))[0] == 403, (
        "logins are accepted only from a page"
    )


def test_a_watching_client_may_not_command(guarded: GuardedDesk) -> None:
    base = Base(guarded)
    with guarded.page(WATCH[0]) as page:
        page.watch("topics", "topic:/cmd_vel")
        page.value("topics", lambda topics: topics is not None)
        commands = {verb for verb, page_verb in guarded.console.verbs.known.items() if page_verb.commands}
        assert {"goto", "patrol", "halt", "paint_flags"} < commands
        for verb in commands:
            assert page.call(verb)["error"] == f"this page has the role 'watch': {verb} is not allowed"
        assert page.call("ping")["ok"]
        page.send(op="hold", x=0.1, y=0.0, turn=0.0)
        page.until(page.errors, "the reason is sent")
        assert page.errors() == ["this page has the role 'watch': it may not drive manually"]
    with guarded.page(DRIVE[0]) as page:
        hold(page, base)


@pytest.mark.parametrize(("name", "role"), [("operator1", "drive"), ("guest", "watch")])
def test_a_certificate_determines_the_role(guarded: GuardedDesk, name: str, role: str) -> None:
    with guarded.page(name=name) as page:
        page.until(lambda: page.others, "the hello arrives")
        assert (page.others[0]["role"], page.others[0]["who"]) == (role, name)
        assert ("role 'watch'" in page.call("stop").get("error", "")) == (role == "watch")


def test_a_certificate_of_another_authority_is_refused(guarded: GuardedDesk, tmp_path: Path) -> None:
    other = Authority(tmp_path / "other")
    other.make()
    other.issue("operator1")
    context = guarded.tls()
    context.load_cert_chain(tmp_path / "other" / "operator1.pem", tmp_path / "other" / "operator1.key")
    with pytest.raises((ssl.SSLError, ConnectionError, WebSocketException)):
        TestPage(guarded.port, ssl=context)


def test_each_command_is_logged_with_its_client(guarded: GuardedDesk, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "midspan.web"):
        with guarded.page(DRIVE[0]) as page:
            page.call("delete_place", name="sofa")
        with guarded.page(name="operator1") as page:
            page.call("delete_place", name="chair")
        guarded.login(DRIVE[0])
    assert "anna at 127.0.0.1:" in caplog.text
    assert "delete_place name='sofa'" in caplog.text
    assert "operator1 at 127.0.0.1:" in caplog.text
    assert DRIVE[0] not in caplog.text


def test_a_wrong_token_does_not_block_other_clients(
    guarded: GuardedDesk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(access, "FIRST_WAIT", 60.0)
    old = {"Authorization": "Bearer of-yesterday", "User_Agent": "dashboard/1"}
    status, headers, body = guarded.ask("GET", "/whoami", **old)
    assert (status, body, "retry-after" in headers) == (401, "no such token\n", False)
    for _ in range(3):
        status, headers, body = guarded.ask("GET", "/whoami", **old)
        assert (status, headers["connection"]) == (429, "close")
        assert 20 < int(headers["retry-after"]) <= 60
        assert f"wait {headers['retry-after']} s" in body
        assert guarded.ask("GET", "/whoami", Authorization=f"Bearer {DRIVE[0]}")[0] == 200
    assert (guarded.ask("GET", "/login", **old)[0], guarded.ask("GET", "/style.css", **old)[0]) == (200, 200)
    with pytest.raises(InvalidStatus) as refused:
        guarded.page("of-yesterday")
    assert refused.value.response.status_code == 429
    assert 0 < int(refused.value.response.headers["Retry-After"]) <= 60
    assert guarded.login("mistyped")[0] == 403, "another wrong token has its own delay"
    status, headers, body = guarded.login("mistyped")
    assert (status, 0 < int(headers["retry-after"]) <= 60) == (429, True)
    assert guarded.login(DRIVE[0])[0] == 200
    for token, name in ((DRIVE[0], ""), ("", "operator1")):
        with guarded.page(token, name) as page:
            assert page.call("ping")["ok"]
    lines = [record.getMessage() for record in caplog.records if "web.tokens" in record.getMessage()]
    assert lines[0] == "127.0.0.1 (program 'dashboard/1') sent a token that is not in web.tokens"
    assert len(lines) == 2, "the log has one line for each wrong token"
    assert "of-yesterday" not in caplog.text


def test_the_log_names_the_client_of_a_proxy_with_a_wrong_token(
    guarded: GuardedDesk, caplog: pytest.LogCaptureFixture
) -> None:
    """Otherwise all clients behind the proxy have its address."""
    guarded.ask("GET", "/whoami", Authorization="Bearer old", User_Agent="dashboard/1", X_Forwarded_For="10.0.0.7")
    sent = "127.0.0.1 (program 'dashboard/1', forwarded for '10.0.0.7') sent a token that is not in web.tokens"
    assert sent in caplog.text


class Guesser:
    """Enters wrong tokens, with a simulated clock and a list in place of the log."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        self.lines: list[str] = []
        log = ScarceLog()
        monkeypatch.setattr(log, "warn", self.lines.append)
        monkeypatch.setattr(time, "monotonic", lambda: self.now)
        self.invalid = WrongTokens(log, "web.tokens")

    def wait(self, address: str, token: str) -> int:
        return self.invalid.refuse(address, token, sender({"user-agent": "curl"}))


@pytest.fixture
def guesser(monkeypatch: pytest.MonkeyPatch) -> Guesser:
    return Guesser(monkeypatch)


def test_a_wrong_token_waits_longer_each_time_and_does_not_delay_others(guesser: Guesser) -> None:
    for wait in (1, 2, 4, 8, 16, 32, 60, 60):
        assert guesser.wait("a", "old") == 0
        guesser.now += 0.01
        assert guesser.wait("a", "old") == wait
        guesser.now += wait
    guesser.wait("a", "old")
    assert [guesser.wait("a", "other"), guesser.wait("b", "old")] == [0, 0]
    guesser.now += access.FORGET_SECONDS + 1.0
    assert guesser.wait("a", "old") == 0
    guesser.now += 0.5
    assert guesser.wait("a", "old") == 1, "a token that was not used for a long time is again without a delay"


def test_many_wrong_tokens_of_an_address_share_a_delay(guesser: Guesser) -> None:
    for number in range(access.MOST_WRONG + 1):
        assert guesser.wait("a", f"n{number}") == 0
    assert guesser.wait("a", "more") > 0
    assert guesser.wait("b", "more") == 0
    assert guesser.lines[-2].endswith(f"sent over {access.MOST_WRONG} different tokens; none is in web.tokens")


def test_wrong_tokens_use_little_memory(guesser: Guesser) -> None:
    for number in range(10_000):
        guesser.wait("a", f"n{number}")
    assert len(guesser.invalid._attempts) == access.MOST_WRONG + 1, "the number of tokens per address is limited"
    for number in range(3 * access.MOST_ENTRIES):
        guesser.wait(f"m{number}", "old")
    assert len(guesser.invalid._attempts) == access.MOST_ENTRIES
    guesser.now += access.FORGET_SECONDS + 1.0
    guesser.wait("a", "old")
    assert len(guesser.invalid._attempts) == 1


def test_a_wrong_token_has_few_log_lines(guesser: Guesser) -> None:
    for _ in range(int(access.LOG_SECONDS) + 2):
        guesser.wait("a", "old")
        guesser.now += 1.0
    requests = int(access.LOG_SECONDS)
    assert guesser.lines == [
        "a (program 'curl') sent a token that is not in web.tokens",
        f"a (program 'curl') sent a token that is not in web.tokens {requests} times since the last such line",
    ]


def test_a_login_expires(monkeypatch: pytest.MonkeyPatch) -> None:
    section = WebSection(tokens={"anna": TokenSection(sha256=DRIVE[1])})
    mine = Access(section, b"s" * 32)
    headers = {"cookie": f"{COOKIE}={mine.login(DRIVE[0], 'a')[1]}"}
    grant = mine.grant(headers, "", "a")
    assert grant == Grant("anna", "drive", grant.until if grant else 0.0)
    assert Access(section, b"t" * 32).grant(headers, "", "a") is None, "a cookie of another console is not accepted"
    other = WebSection(tokens={"anna": TokenSection(sha256=WATCH[1])})
    assert Access(other, b"s" * 32).grant(headers, "", "a") is None, "the token has been replaced"
    late = time.time() + access.LOGIN_SECONDS + 10.0
    monkeypatch.setattr(time, "time", lambda: late)
    assert mine.grant(headers, "", "a") is None


def test_the_secret_is_readable_only_by_its_owner(tmp_path: Path) -> None:
    secret = stored_secret(tmp_path / "state")
    assert stored_secret(tmp_path / "state") == secret
    assert stat.S_IMODE((tmp_path / "state" / "web.secret").stat().st_mode) == 0o600
    (tmp_path / "file").write_text("")
    with pytest.raises(RuntimeError, match="the console stores its key"):
        stored_secret(tmp_path / "file")


def test_the_certificates_names_are_valid_hosts(guarded: GuardedDesk) -> None:
    """This prevents DNS rebinding, because a name that an attacker points to this address is not in the certificate."""
    port = guarded.port
    token = {"Authorization": f"Bearer {DRIVE[0]}"}
    for host in ("robot.test", "127.0.0.1", "here", "HERE.local"):
        assert guarded.ask("GET", "/whoami", Host=f"{host}:{port}", **token)[0] == 200
    for host in ("evil.example", "robot.test.evil.example", "10.0.0.1"):
        status, _, body = guarded.ask("GET", "/whoami", Host=f"{host}:{port}", **token)
        assert status == 403
        assert "unknown host" in body
    for origin in ("http://127.0.0.1:{}", "https://evil.example:{}"):
        with pytest.raises(InvalidStatus, match="403"):
            TestPage(port, ssl=guarded.tls(), additional_headers=token, origin=origin.format(port))
    assert hosts(["robot"], 443, tls=True) >= {"robot:443", "robot"}
    guarded.open_with(web={"names": ["tablet.test"]})
    assert guarded.ask("GET", "/whoami", Host=f"tablet.test:{guarded.port}", **token)[0] == 200
    assert guarded.ask("GET", "/whoami", Host=f"robot.test:{guarded.port}", **token)[0] == 403
    assert guarded.console.server.address == f"https://tablet.test:{guarded.port}/"


def test_plain_http_gets_no_response(guarded: GuardedDesk) -> None:
    with pytest.raises((http.client.HTTPException, ConnectionError)):
        ask(guarded.port, "/login")


def test_a_connection_without_a_tls_handshake_is_closed(guarded: GuardedDesk) -> None:
    with connect(guarded.port) as sock:
        assert is_closed(sock)


@pytest.mark.parametrize(
    ("break_", "why"),
    [("missing", "is no .*here.key"), ("expired", "here.pem expired on"), ("junk", "is not a certificate"),
     ("other", "was not signed by"), ("unfit", "is not the key of")],
)  # fmt: skip
def test_invalid_key_files_are_named(guarded: GuardedDesk, tmp_path: Path, break_: str, why: str) -> None:
    keys = guarded.keys
    if break_ == "missing":
        (keys / "here.key").unlink()
    elif break_ == "expired":
        Authority(keys).issue("here", days=0, replace=True)
    elif break_ == "junk":
        (keys / "here.pem").write_text("junk")
    elif break_ == "other":
        Authority(tmp_path / "other").make()
        (tmp_path / "other" / "ca.pem").replace(keys / "ca.pem")
    else:
        (keys / "guest.key").replace(keys / "here.key")
    with pytest.raises(RuntimeError, match=why):
        guarded.open()


def test_a_renewed_certificate_is_loaded(guarded: GuardedDesk) -> None:
    def number() -> bytes:
        with guarded.page(DRIVE[0]) as page:
            peer = page.socket.socket.getpeercert(binary_form=True)  # type: ignore[attr-defined]
            assert peer
            return bytes(peer)

    before = number()
    Authority(guarded.keys).issue("here", ["127.0.0.1"], replace=True)

    def is_renewed() -> bool:
        guarded.console.refresh_tls()
        return number() != before

    until(is_renewed, "the console presents the new certificate")


def test_a_new_authority_restarts_the_console(guarded: GuardedDesk, tmp_path: Path) -> None:
    """A new authority excludes the machines that have certificates of the previous one."""
    keys, new = guarded.keys, Authority(tmp_path / "new")
    new.make()
    new.issue("here", ["127.0.0.1"])
    (new.folder / "ca.pem").replace(keys / "ca.pem")
    for _ in range(2):  # a change is noticed by the second check
        guarded.console.refresh_tls()  # the other files are still those of the previous authority
    for name in ("here.pem", "here.key"):
        (new.folder / name).replace(keys / name)
    guarded.console.refresh_tls()
    with pytest.raises(WorkerFailedError, match=r"the console has a new authority, .*ca\.pem: restarting"):
        guarded.console.refresh_tls()
