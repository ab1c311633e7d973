"""The daemon's small parts: protocol, pauses, log lines, locks, limits, the workers' table."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.concurrency import Backoff
from bridge.config.load import load
from bridge.config.model import Config
from bridge.daemon import log
from bridge.daemon.lock import Lock
from bridge.daemon.protocol import (
    Beat,
    Failed,
    Hello,
    Lines,
    LogLine,
    NewConfig,
    ProtocolError,
    Reloaded,
    Report,
    Restart,
    Stop,
    Unknown,
    decode_command,
    decode_report,
    encode_command,
    encode_report,
)
from bridge.daemon.supervisor import Supervisor
from bridge.daemon.workers import VARIABLE, worker_kinds
from bridge.progress import Busy
from bridge.state_file import named, state_folder, with_state, worker_folder
from bridge.worker import Health

REPORTS = [
    Beat(3, Health("standby", "2 routes\n\u00fc")),
    Hello(7, "service"),
    Hello(7, "daemon"),
    Reloaded(),
    Restart("why"),
    Failed("why"),
    LogLine(30, "text"),
    Busy("importing rclpy", 1.25, 8),
]


@pytest.mark.parametrize("report", REPORTS, ids=lambda report: type(report).__name__)
def test_reports_survive_the_wire(report: Report) -> None:
    line = encode_report(report)
    assert line.count(b"\n") == 1
    assert line.endswith(b"\n")
    assert decode_report(line) == report


def test_a_report_of_another_version_is_unknown_but_not_an_error() -> None:
    assert decode_report(b'{"novel": 1, "more": {}}') == Unknown(("novel", "more"))


def test_commands_survive_the_wire() -> None:
    config = Config(name="a", state=Path("/s"))
    assert decode_command(encode_command(NewConfig(config))) == NewConfig(config)
    assert isinstance(decode_command(encode_command(Stop())), Stop)


BAD = [
    b"",
    b"x",
    b"[]",
    b"null",
    b"{}",
    b'{"beat": "1", "state": "running", "text": ""}',
    b'{"beat": 1, "state": "odd", "text": ""}',
    b'{"hello": {"pid": 1, "owner": "me"}}',
    b'{"log": [1]}',
    b'{"busy": "x", "used": "1", "read": 0}',
    b"\xff",
    b"[" * 100_000,
]


@pytest.mark.parametrize("line", BAD, ids=range(len(BAD)))
def test_an_invalid_line_is_a_protocol_error(line: bytes) -> None:
    with pytest.raises(ProtocolError):
        decode_report(line)
    with pytest.raises(ProtocolError):
        decode_command(line)


@given(st.lists(st.binary(max_size=8)), st.integers(1, 5))
def test_lines_do_not_depend_on_how_the_stream_is_split(parts: list[bytes], limit: int) -> None:
    stream = b"".join(parts) + b"\n"
    whole = Lines(limit).feed(stream)
    lines = Lines(limit)
    cut = [line for part in [*parts, b"\n"] for line in lines.feed(part)]
    assert cut == whole
    assert whole == [line[:limit] for line in stream.split(b"\n")[:-1]]
    assert lines.end() == []


def test_pauses_double_up_to_a_limit_and_reset_after_a_long_run() -> None:
    backoff = Backoff()
    assert [backoff.pause(1.0) for _ in range(8)] == [0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 10.0, 10.0]
    assert backoff.pause(29.0) == 10.0
    assert backoff.pause(31.0) == 0.2
    backoff.pause(0)
    backoff.reset()
    assert backoff.pause(0) == 0.2


@pytest.mark.parametrize(
    ("line", "level", "text"),
    [
        ("<3>bad", logging.ERROR, "bad"),
        ("<4>odd", logging.WARNING, "odd"),
        ("<6>note", logging.INFO, "note"),
        ("<7>detail", logging.DEBUG, "detail"),
        ("a library's", logging.WARNING, "a library's"),
        ("<9>what", logging.WARNING, "<9>what"),
        (
            "[INFO] [1796.5] [rcl]: Found security directory: /k",
            logging.INFO,
            "[INFO] [1796.5] [rcl]: Found security directory: /k",
        ),
        ("[WARN] [1796.5] [rcl]: odd", logging.WARNING, "[WARN] [1796.5] [rcl]: odd"),
        ("\x1b[37;1m2026 \x1b[31;1m[SECURITY Error]\x1b[m", logging.WARNING, "2026 [SECURITY Error]"),
    ],
)
def test_a_log_lines_priority_is_split_off(line: str, level: int, text: str) -> None:
    assert log.split_priority(line) == (level, text)
    if line.startswith(f"<{log.priority(level)}>"):
        assert f"<{log.priority(level)}>{text}" == line


def test_every_line_of_a_record_carries_priority_and_name() -> None:
    record = logging.LogRecord("x", logging.ERROR, "", 0, "one\ntwo", None, None)
    record.worker = "ros1"
    assert log.LineFormatter(log.Style.JOURNAL, "midspan").format(record) == "<3>ros1: one\n<3>ros1: two"


def test_relayed_lines_are_queued_until_they_are_delivered(capsys: pytest.CaptureFixture[str]) -> None:
    handler = log.RelayHandler()
    for number in range(log.RECENT_LINES + 5):
        handler.handle(logging.LogRecord("x", logging.INFO, "", 0, f"line {number}", None, None))
    received: list[str] = []

    def deliver(level: int, text: str) -> bool:
        assert level == logging.INFO
        received.append(text)
        return len(received) < 3

    handler.relay_to(deliver)
    handler.flush()
    assert received == ["line 5", "line 6", "line 7"]
    handler.relay_to(lambda _level, _text: False)
    handler.close()
    written = capsys.readouterr().err.splitlines()
    assert written[0] == "<6>line 7"  # the line was not delivered, so it is still pending
    assert written[-1] == f"<6>line {log.RECENT_LINES + 4}"


def test_log_records_are_dropped_and_counted_while_the_reader_is_suspended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "FLUSH_SECONDS", 20.0)  # the thread that writes may be starved
    reader, writer = os.pipe()
    with os.fdopen(writer, "w") as stderr, os.fdopen(reader) as lines:
        os.set_blocking(writer, False)
        for filling in (b"-\n" * 1000, b"\n"):
            with contextlib.suppress(BlockingIOError):
                while True:
                    os.write(writer, filling)
        os.set_blocking(writer, True)
        monkeypatch.setattr(sys, "stderr", stderr)
        handler = log.StderrHandler()
        for number in range(log.WAITING_RECORDS + 5):
            handler.handle(logging.LogRecord("x", logging.INFO, "", 0, f"line {number}", None, None))
        assert next(line for line in lines if line not in ("-\n", "\n")) == "line 0\n"
        handler.flush()
        handler.handle(logging.LogRecord("x", logging.INFO, "", 0, "last", None, None))
        handler.flush()
        handler.close()
        stderr.close()
        left = lines.read().splitlines()
    assert left[-1] == "last"
    assert re.fullmatch("[45] log messages were dropped, because the reader of the log was suspended", left[-2])


def test_logging_works_without_stderr(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    monkeypatch.setattr(log, "FLUSH_SECONDS", 40.0)
    handler = log.StderrHandler()
    handler.handle(logging.LogRecord("x", logging.INFO, "", 0, "line", None, None))
    start = time.monotonic()
    handler.flush()
    assert time.monotonic() - start < log.FLUSH_SECONDS
    handler.close()


def test_a_lock_lasts_while_any_process_has_its_descriptor(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    first, second = Lock(path), Lock(path)
    assert first.try_lock()
    first.write(os.getpid(), "service")
    assert not second.try_lock()
    holder = second.holder()
    assert holder is not None
    assert (holder.pid, holder.owner, holder.is_here) == (os.getpid(), "service", True)
    inherited = os.dup(first.passed_on[0])
    first.close()
    assert not second.try_lock()
    os.close(inherited)
    assert second.try_lock()
    second.close()


def test_a_lock_belongs_to_this_machine_even_after_a_rename(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lock = Lock(tmp_path / "lock")
    monkeypatch.setattr("socket.gethostname", lambda: "robot1")
    lock.write(1, "daemon")
    monkeypatch.setattr("socket.gethostname", lambda: "robot2")
    holder = lock.holder()
    assert holder is not None
    assert (holder.machine, holder.is_here) == ("robot1", True)
    assert replace(holder, machine="robot2", space="an earlier boot").is_here, "the machine has been restarted since"
    for space in ("another boot", ""):
        assert not replace(holder, space=space).is_here
    lock.close()


@pytest.mark.parametrize("text", ["", "{}", "nonsense", '{"pid": "x", "machine": 1, "owner": 2}', "[1]"])
def test_a_lock_file_with_other_content_has_no_holder(tmp_path: Path, text: str) -> None:
    path = tmp_path / "lock"
    path.write_text(text)
    lock = Lock(path)
    assert lock.holder() is None
    lock.close()


@pytest.mark.parametrize(
    ("environ", "folder"),
    [
        ({"STATE_DIRECTORY": "/var/lib/midspan:/b", "HOME": "/h"}, "/var/lib/midspan"),
        ({"XDG_STATE_HOME": "/x", "HOME": "/h"}, "/x/midspan"),
        ({"HOME": "/h"}, "/h/.local/state/midspan"),
    ],
)
def test_the_state_folder_follows_from_configuration_and_environment(environ: dict[str, str], folder: str) -> None:
    assert state_folder(Config(), environ) == Path(folder)
    assert state_folder(Config(state=Path("/own")), environ) == Path("/own")


def test_a_renamed_machine_keeps_the_daemons_name_and_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    environ = {"STATE_DIRECTORY": str(tmp_path / "state")}
    monkeypatch.setattr("socket.gethostname", lambda: "robot1")
    first = with_state(Config(), environ)
    assert (first.name, named(Config(), environ).name) == ("robot1", "robot1")
    monkeypatch.setattr("socket.gethostname", lambda: "robot2")
    renamed = with_state(Config(), environ)
    assert (renamed.name, worker_folder(renamed)) == ("robot1", worker_folder(first))
    assert with_state(Config(name="own"), environ).name == "own"
    assert named(Config(), environ).name == "robot1", "a configured name is not stored"
    assert named(Config(), {"STATE_DIRECTORY": "/none"}, tmp_path / "state").name == "robot1"
    other = Config(state=tmp_path / "other")
    assert named(other, environ, tmp_path / "state").name == "robot2", "a configured state folder is the only one"


@pytest.mark.parametrize("stored", [b"", b"../x", b"a b", b"\xff\xfe", b"x" * 100])
def test_an_invalid_stored_name_is_replaced(stored: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "robot1")
    (tmp_path / ".name").write_bytes(stored)
    assert with_state(Config(state=tmp_path)).name == "robot1"
    assert (tmp_path / ".name").read_text() == "robot1\n"


def test_a_daemon_reports_and_reloads_under_its_stored_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "midspan.yaml"
    file.write_text("state: state\n")
    monkeypatch.setattr("socket.gethostname", lambda: "robot1")
    with_state(load(file))
    monkeypatch.setattr("socket.gethostname", lambda: "robot2")
    supervisor = Supervisor(file, environ={})
    supervisor.request_stop()
    supervisor.run()
    assert "robot1: the machine's name is robot2 now; this daemon keeps the name" in caplog.text
    assert supervisor._source.reload(supervisor.config) == supervisor.config


def test_the_variable_replaces_workers_in_the_table() -> None:
    kinds = worker_kinds({VARIABLE: "ros1=a.b:C"})
    assert (kinds["ros1"].factory, kinds["ros1"].arguments, kinds["ros1"].environment) == ("a.b:C", (), "")
    assert worker_kinds({VARIABLE: "web=a.b:C"})["web"].needs == ()
    assert kinds["ros2"].factory == "bridge.adapters.worker:BridgeWorker"
    with pytest.raises(RuntimeError, match="is not NAME=module:Class; NAME is one of router, ros1_master, ros1, ros2"):
        worker_kinds({VARIABLE: "ros3=a:B"})


def test_a_worker_names_missing_packages_and_the_extra_that_installs_them(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = worker_kinds({})
    assert [kind.missing(Config()) for kind in (kinds["router"], kinds["web"], kinds["foxglove"])] == ["", "", ""]
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name != "uvicorn" else name)
    assert kinds["router"].missing(Config()) == ""
    assert kinds["metrics"].missing(Config()) == "starlette, websockets cannot be imported; pip install 'midspan[web]'"
    assert kinds["foxglove"].missing(Config()) == "foxglove cannot be imported; pip install 'midspan[foxglove]'"


def test_workers_do_not_get_the_daemons_systemd_variables() -> None:
    environ = {"NOTIFY_SOCKET": "/n", "WATCHDOG_USEC": "1", "JOURNAL_STREAM": "1:2", "PATH": "/bin"}
    env = worker_kinds({})["router"].child_environment(Config(), environ)
    assert env["PATH"] == "/bin"
    assert not {"NOTIFY_SOCKET", "WATCHDOG_USEC", "JOURNAL_STREAM"} & set(env)


def test_a_guarded_console_restarts_if_the_listeners_certificate_changes() -> None:
    kind = worker_kinds()["web"]
    token = {"anna": {"sha256": "0" * 64}}
    guarded, plain = ({"web": {"tokens": tokens}} for tokens in (token, {}))

    def part(web: dict[str, object], keys: str) -> dict[str, object]:
        return kind.config_part(Config.model_validate({"name": "a", **web, "hub": {"open": {"keys": keys}}}))

    assert part(guarded, "/a") != part(guarded, "/b")
    assert part(plain, "/a") == part(plain, "/b")


_HUB_NODES = [name for name in worker_kinds({}) if name not in ("router", "ros1_master")]
_RECEIVERS = [name for name in _HUB_NODES if name != "metrics"]


@pytest.mark.parametrize(
    ("name", "section"),
    [
        *((name, {"clock": {"source": "sim"}}) for name in _HUB_NODES),
        *((name, {"limits": {"message": 1}}) for name in _RECEIVERS),
    ],
)
def test_a_reload_reaches_all_workers_that_use_the_section(name: str, section: dict[str, object]) -> None:
    kind, state = worker_kinds({})[name], {"state": "/state"}
    before, after = Config.model_validate(state), Config.model_validate({**state, **section})
    assert kind.config_part(before) == kind.config_part(Config.model_validate(state))
    assert kind.config_part(before) != kind.config_part(after)
