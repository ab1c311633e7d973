"""The daemon in the console: log, doctor, configuration."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.daemon.log_query import LOG, RecentLines
from bridge.daemon.query import STATUS, QueryServer
from bridge.web.verbs import inspection
from bridge.web.verbs.config_text import HIDDEN, secrets_of, without_secrets
from tests.peers.browser.page import TestPage
from tests.web.conftest import Desk
from yarp_compat.selector_loop import SelectorLoop


class Daemon:
    """A daemon that responds on its socket."""

    def __init__(self, folder: Path, file: Path) -> None:
        self._loop = SelectorLoop()
        self.kept = RecentLines()
        self._over = False
        verbs = {STATUS: lambda _: {"config": str(file)}, LOG: self.kept.respond}
        self._server = QueryServer(self._loop, folder / "here.daemon.sock", verbs)
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._over:
            self._loop.step(0.2)

    def log_line(self, text: str, level: int = logging.INFO, worker: str = "ros1") -> None:
        record = logging.LogRecord("midspan", level, "", 0, text, None, None)
        record.worker = worker
        self.kept.handle(record)

    def close(self) -> None:
        if self._over:
            return
        self._over = True
        self._loop.wake()
        self._thread.join()
        self._server.close()
        self._loop.close()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "midspan.yaml"


@pytest.fixture
def daemon(desk: Desk, tmp_path: Path, file: Path) -> Iterator[Daemon]:
    assert desk.port
    daemon_ = Daemon(tmp_path, file)
    yield daemon_
    daemon_.close()


def test_the_log_is_live_and_filtered(desk: Desk, daemon: Daemon) -> None:
    daemon.log_line("the first")
    with TestPage(desk.port) as page:
        page.watch("log")
        assert page.value("log") == {"last": 1, "workers": ["ros1"]}
        daemon.log_line("no master\nanywhere", logging.WARNING)
        daemon.log_line("a port is taken", logging.ERROR, "yarp")
        assert page.value("log", lambda value: value and value["last"] == 4)["workers"] == ["ros1", "yarp"]

        def texts(**args: Any) -> list[str]:
            return [line["text"] for line in page.call("log", **args)["value"]["lines"]]

        assert texts() == ["the first", "no master", "anywhere", "a port is taken"]
        assert texts(after=2) == ["anywhere", "a port is taken"]
        assert texts(level="warning") == ["no master", "anywhere", "a port is taken"]
        assert texts(level="error", worker="ros1") == []
        assert texts(text="PORT a") == ["a port is taken"]
        assert page.call("log", after=4)["value"] == {"last": 4, "lines": []}


def test_a_long_log_is_read_completely_and_returned_in_part(desk: Desk, daemon: Daemon) -> None:
    for number in range(1500):
        daemon.log_line(f"line {number} {'x' * 200}")
    with TestPage(desk.port) as page:
        page.watch("log")
        page.value("log", lambda value: value and value["last"] == 1500)
        lines = page.call("log")["value"]["lines"]
        assert [line["n"] for line in lines] == list(range(1001, 1501)), "only the newest lines are sent"


def test_the_log_of_a_restarted_daemon_starts_again(desk: Desk, daemon: Daemon, tmp_path: Path, file: Path) -> None:
    for number in range(5):
        daemon.log_line(str(number))
    with TestPage(desk.port) as page:
        page.watch("log")
        page.value("log", lambda value: value and value["last"] == 5)
        daemon.close()
        page.until(lambda: page.values["log"]["value"] is None, "the daemon is not running")
        assert "the daemon does not respond" in page.values["log"]["why"]
        with contextlib.closing(Daemon(tmp_path, file)) as again:
            again.log_line("anew")
            page.value("log", lambda value: value and value["last"] == 1)
            assert [line["text"] for line in page.call("log")["value"]["lines"]] == ["anew"]


@pytest.mark.parametrize(
    ("args", "why"),
    [
        ({"after": -1}, "log: after must be a line number, not -1"),
        ({"after": True}, "log: after must be a line number, not True"),
        ({"level": "loud"}, "log: level must be one of debug, info, warning, error, not 'loud'"),
        ({"text": "x" * 300}, "log: text must be a text of up to 200 characters"),
        ({"side": "ros1"}, "log has no argument 'side'; it has after, level, worker, text"),
    ],
)
def test_invalid_filters_are_refused(desk: Desk, args: dict[str, Any], why: str) -> None:
    with TestPage(desk.port) as page:
        assert why in page.call("log", **args)["error"]


def test_the_configuration_is_shown_with_its_comments(desk: Desk, daemon: Daemon, file: Path) -> None:
    assert daemon
    zenoh = "  zenoh: {transport: {auth: {pubkey: {private_key_pem: hunter2}}}}"
    file.write_text(f"# of the lab's robot\nname: here\nhub:\n{zenoh}\n", encoding="utf-8")
    with TestPage(desk.port) as page:
        config = page.call("config")["value"]
        assert config["file"] == str(file)
        assert config["text"] == (
            "# of the lab's robot\nname: here\nhub:\n"
            f"  zenoh: {{transport: {{auth: {{pubkey: {{private_key_pem: {HIDDEN}}}}}}}}}\n"
        )
        assert config["problems"] == []


def test_the_check_names_every_problem(desk: Desk, daemon: Daemon, file: Path) -> None:
    assert daemon
    file.write_text("nam: here\nlog:\n  level: loud\n", encoding="utf-8")
    with TestPage(desk.port) as page:
        problems = page.call("config")["value"]["problems"]
        assert [(problem["line"], problem["key"]) for problem in problems] == [(1, "nam"), (3, "log.level")]
        assert problems[0]["text"] == "unknown key 'nam'; did you mean 'name'?"


def test_an_unreadable_configuration_is_reported(desk: Desk, daemon: Daemon, file: Path) -> None:
    assert daemon
    with TestPage(desk.port) as page:
        config = page.call("config")["value"]
        assert config["text"] is None
        assert "no such file" in config["why"]
        file.write_text("name: [\npassword: hunter2hunter2\n", encoding="utf-8")
        config = page.call("config")["value"]
        assert config["text"] is None
        assert "not valid YAML" in config["why"]
        assert "not valid YAML" in config["problems"][0]["text"]
        assert "hunter2" not in str(config)


@pytest.mark.parametrize(
    ("text", "secret"),
    [
        ("password: hunter2\n", "hunter2"),
        ("web:\n  tokens:\n    - abcdef\n    - {name: me, token: ghijkl}\n", "abcdef"),
        ("tokens: {s3cr3t: drive}\n", "s3cr3t"),
        ("key: |\n  -----BEGIN PRIVATE KEY-----\n  MIIE\n  -----END PRIVATE KEY-----\nname: x\n", "MIIE"),
        ("shared: &it correcthorse\napi_key: *it\n", "correcthorse"),
        ("# password: hunter2\n", "hunter2"),
        ("name: x # the token: hunter2\n", "hunter2"),
        ("listen: tls://me:hunter2@host:1\n", "hunter2"),
        ("secret: 'two\n  lines'\n", "lines"),
        ("'connect_private_key_base64': AAAA\n", "AAAA"),
        ("# it was correcthorse once\npassword: correcthorse\n", "correcthorse"),
        ("? token\n: hunter2\n", "hunter2"),
    ],
)
def test_secrets_are_hidden(text: str, secret: str) -> None:
    shown = without_secrets(text, secrets_of(text))
    assert secret not in shown
    assert HIDDEN in shown
    assert shown.count("\n") >= text.count("\n") - 3


def test_other_values_are_not_hidden() -> None:
    text = "name: here # whose token is elsewhere\nkeys: /etc/midspan/keys\nzenoh:\n  keys: [{key: robot/pose}]\n"
    assert without_secrets(text, secrets_of(text)) == text


def test_problems_do_not_reveal_secrets(desk: Desk, daemon: Daemon, file: Path) -> None:
    assert daemon
    file.write_text("web:\n  token: hunter2\nname: correct horse\nsecret: correct horse\n", encoding="utf-8")
    with TestPage(desk.port) as page:
        text = str(page.call("config")["value"])
        assert "hunter2" not in text
        assert "correct horse" not in text


def test_the_doctor_returns_its_findings(desk: Desk, daemon: Daemon, file: Path) -> None:
    assert daemon
    file.write_text("nam: here\n", encoding="utf-8")
    with TestPage(desk.port) as page:
        findings = page.call("doctor")["value"]
        about = {entry["check"]: entry for entry in findings}
        assert about["config"]["result"] == "fail", about["config"]
        assert "did you mean 'name'?" in about["config"]["seen"]
        assert about["config"]["cure"]
        assert {"kernels", "clock", "shm-size"} <= about.keys()


def test_only_one_doctor_runs_at_a_time(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, may_end = threading.Event(), threading.Event()

    def examine(_self: inspection.Doctor) -> list[Any] | None:
        begun.set()
        return [] if may_end.wait(60) else None

    monkeypatch.setattr(inspection.Doctor, "_examine", examine)
    with TestPage(desk.port) as first, TestPage(desk.port) as other:
        first.send(op="call", id=1, verb="doctor")
        assert begun.wait(40), "the first call runs"
        assert "the doctor is already running" in other.call("doctor")["error"]
        may_end.set()
        first.until(lambda: any(m.get("id") == 1 and m["ok"] for m in first.others), "the first call gets its reply")
        assert other.call("doctor")["ok"], "the next call may run again"
