"""zenoh's log is captured in a worker's process, and its warnings are logged at a limited rate."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.security import zenoh_log
from bridge.hub.security.certificates import Authority
from tests.support.ports import free_port

PROGRAM = """
import json, logging, sys, time
import zenoh
from pathlib import Path
from bridge.hub.security.handshake import HostPort, Identity, attempt
from bridge.hub.security.zenoh_log import ZenohLog

folder, port = Path(sys.argv[1]), sys.argv[2]
logging.basicConfig(format="%(levelname)s %(message)s")
log = ZenohLog.capture()
log = ZenohLog.capture()
print("a line of the program", flush=True)
tls = {"root_ca_certificate": f"{folder}/a/ca.pem", "listen_certificate": f"{folder}/a/robot1.pem",
       "listen_private_key": f"{folder}/a/robot1.key", "enable_mtls": True}
config = {"mode": "router", "scouting": {"multicast": {"enabled": False}}, "transport": {"link": {"tls": tls}},
          "listen": {"endpoints": [f"tls/127.0.0.1:{port}"]},
          "connect": {"endpoints": ["tcp/127.0.0.1:1"], "timeout_ms": -1, "exit_on_failure": False}}
session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
place = HostPort.of(f"tls/127.0.0.1:{port}")
own = {name: Identity(folder / "a/ca.pem", folder / name / "robot1.pem", folder / name / "robot1.key") for name in "ab"}
states = [attempt(place, own["a"]).reason.state for _ in range(3)]
end = time.monotonic() + 20
while not log.failure("tcp/127.0.0.1:1", 0) and time.monotonic() < end:
    time.sleep(0.02)
after_good = [refusal.error for refusal in log.refusals(0)]
states.append(attempt(place, own["b"]).reason.state)
while not log.refusals(0) and time.monotonic() < end:
    time.sleep(0.02)
refused = [refusal.error for refusal in log.refusals(0)]
session.close()
ZenohLog.release()
print("the last line", flush=True)
print(json.dumps([states, after_good, refused, log.failure("tcp/127.0.0.1:1", 0)]), file=sys.stderr)
"""


@pytest.mark.parametrize("rust_log", ["", "zenoh_link_tls=warn,zenoh::net::runtime::orchestrator=debug"])
def test_log_holds_only_refusals(tmp_path: Path, rust_log: str) -> None:
    for fleet in ("a", "b"):
        Authority(tmp_path / fleet).make()
        Authority(tmp_path / fleet).issue("robot1", ["127.0.0.1"])
    command = [sys.executable, "-c", PROGRAM, str(tmp_path), str(free_port())]
    environ = {key: value for key, value in os.environ.items() if key != "RUST_LOG"} | (
        {"RUST_LOG": rust_log} if rust_log else {}
    )
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, check=True, env=environ)
    lines = done.stderr.splitlines()
    result: list[Any] = json.loads(lines[-1])
    states, after_good, refused, failure = result
    assert states == ["connecting"] * 3 + ["refused"]
    assert after_good == [], "the listener logs no refusal for a test connection"
    assert len(refused) == 1
    assert refused[0].startswith("invalid peer certificate: ")
    assert "Connection refused" in failure
    assert ".rs:" not in failure
    assert "a line of the program" in lines
    assert "the last line" in lines
    warnings = [line for line in lines if "zenoh_link_tls" in line]
    if rust_log:
        assert all("WARN" in line and not line.startswith("WARNING ") for line in warnings)
    else:
        assert [line.partition("::")[0] for line in warnings] == ["WARNING zenoh: zenoh_link_tls"]
    assert done.stdout == ""


START = "2026-11-28T18:18:15.173896Z "
FAR = START + "ERROR rx-0 ThreadId(07) zenoh::net: lost 7f3bed04fbd8507a149f7b50a97a3f{:02x} of 10.0.0.{}"


def logged(caplog: pytest.LogCaptureFixture) -> list[tuple[int, str]]:
    lines = [(r.levelno, r.getMessage()) for r in caplog.records if r.name == zenoh_log.__name__]
    caplog.clear()
    return lines


def test_log_is_read_although_stderr_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The router survives the daemon, which reads its stderr."""
    original = os.write

    def write(descriptor: int, data: bytes) -> int:
        if descriptor == 2:
            raise BrokenPipeError
        return original(descriptor, data)

    output, to_log = os.pipe()
    at = "2026-01-01T00:00:00.000000Z DEBUG ThreadId(02) zenoh::net::runtime::orchestrator:"
    with os.fdopen(to_log, "wb") as pipe:
        pipe.write(b"a line of the program\n")
        pipe.write(f"{at} Unable to connect to configured peer tcp/127.0.0.1:1! refused\n".encode())
    monkeypatch.setattr(os, "write", write)
    log = zenoh_log.ZenohLog()
    log._run(output)
    assert log.failure("tcp/127.0.0.1:1", 0) == "refused"


def test_each_kind_of_warning_is_logged_once_a_minute(caplog: pytest.LogCaptureFixture) -> None:
    warnings = zenoh_log.ZenohWarnings()
    for number in range(100):
        warnings.feed(FAR.format(number, number), 5.0)
    warnings.feed(START + " WARN net-0 ThreadId(03) zenoh::net: another", 6.0)
    warnings.feed(START + " WARN ThreadId(03) zenoh::net: " + "x" * 5000, 6.0)
    levels, texts = zip(*logged(caplog), strict=True)
    assert levels == (logging.ERROR, logging.WARNING, logging.WARNING)
    assert texts[0] == "zenoh: zenoh::net: lost 7f3bed04fbd8507a149f7b50a97a3f00 of 10.0.0.0"
    assert len(texts[2]) < 600
    warnings.feed(FAR.format(1, 1), 5.0 + zenoh_log.AGAIN_SECONDS)
    (_, count), (level, again) = logged(caplog)
    assert count == "zenoh: 99 warnings like those before were not logged"
    assert level == logging.ERROR
    assert "10.0.0.1" in again


def test_many_kinds_of_warnings_are_limited(caplog: pytest.LogCaptureFixture) -> None:
    warnings = zenoh_log.ZenohWarnings()
    for number in range(1000):
        warnings.feed(START + f" WARN ThreadId(03) zenoh: {'x' * number}", 5.0)
    assert len(logged(caplog)) <= 20


@pytest.mark.parametrize(
    "line",
    [
        " WARN ThreadId(01) zenoh::net::runtime::orchestrator: Scouting delay elapsed before start conditions are met.",
        " WARN rx-0 ThreadId(01) zenoh::api::session: Received ResponseFinal for unknown Request: 7",
        "DEBUG rx-0 ThreadId(01) zenoh::net::runtime::orchestrator: Unable to connect to configured peer x! y",
        " INFO rx-0 ThreadId(01) zenoh: hi",
    ],
)
def test_harmless_lines_are_not_logged(caplog: pytest.LogCaptureFixture, line: str) -> None:
    zenoh_log.ZenohWarnings().feed(START + line, 5.0)
    assert not logged(caplog)
