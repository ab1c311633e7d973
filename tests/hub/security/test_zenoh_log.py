"""zenoh's log is captured in a process that runs nothing else, like the router's process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.security.certificates import Authority
from tests.support.ports import free_port

PROGRAM = """
import json, sys, time
import zenoh
from pathlib import Path
from bridge.hub.security.handshake import HostPort, Identity, attempt
from bridge.hub.security.zenoh_log import ZenohLog

folder, port = Path(sys.argv[1]), sys.argv[2]
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
    assert any("zenoh_link_tls" in line for line in lines) is bool(rust_log)
    assert done.stdout == ""
