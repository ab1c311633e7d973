"""Parts of the YARP side that need no network."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.adapters.yarp import environment
from bridge.adapters.yarp.network import PortNames
from bridge.adapters.yarp.services import MAX_CALLS, PortCaller
from bridge.adapters.yarp.topics import envelope, on_system_clock, stamp
from bridge.config.model import Config
from bridge.daemon.workers import worker_kinds
from bridge.hub.endpoints.calls import CallError
from tests.support.no_threads import no_threads
from tests.support.wait import until
from yarp_compat.ports import loop
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.binary import encode
from yarp_compat.wire.profile import Profile


@given(st.integers(1, 1 << 61), st.integers(0, 10**9))
def test_stamps_survive_the_envelope(stamp_ns: int, count: int) -> None:
    assert stamp(envelope(count, stamp_ns)) == stamp_ns


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("3580 1795143618.02289", 1_795_143_618_022_890_000),
        ("7 12", 12_000_000_000),
        ("1 1.5e9", 1_500_000_000_000_000_000),
        ("", None),
        ("hello", None),
        ("1 nan", None),
        ("1 -5.0", None),
        ("1 0.0", None),
        ("1 1e99", None),
        ("(1 2) 3", None),
    ],
)
def test_only_valid_envelopes_of_other_programs_give_a_stamp(text: str, stamp_ns: int | None) -> None:
    assert stamp(text) == stamp_ns


@given(st.text(max_size=40))
def test_any_envelope_is_accepted(text: str) -> None:
    stamp_ns = stamp(text)
    assert stamp_ns is None or 0 < stamp_ns < 1 << 62


def test_simulated_times_are_not_on_the_system_clock() -> None:
    assert on_system_clock(12_000_000_000) is None
    assert on_system_clock(now := time.time_ns()) == now
    assert envelope(1, None) == envelope(1, 0) == ""


def test_port_names_follow_the_schemes() -> None:
    names = PortNames("/midspan{topic}:o", "/robot/in{topic}", "/midspan{topic}/rpc", "r1")
    assert names.output("/camera/image") == "/midspan/camera/image:o"
    assert names.input("/scan/from/laser:o") == "/robot/in/scan/from/laser:o"
    assert names.alternative(names.output("/scan")) == "/midspan/r1/scan:o"
    assert names.alternative(names.input("/scan")) == "/robot/in/r1/scan"
    assert names.matches("/midspan/scan:o")
    assert not names.matches("/other/scan:o")


def test_worker_runs_if_yarp_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("YARP_NAMESPACE", raising=False)
    kind = worker_kinds({})["yarp"]
    unused, configured = Config(), Config.model_validate({"yarp": {"poll": 1}})
    assert "YARP is not used here" in environment.available(unused)
    assert kind.enabled(unused) is False
    assert kind.enabled(Config.model_validate({"yarp": {"enabled": True}})) is True
    assert kind.enabled(configured) == "auto"
    assert environment.available(configured) == ""
    (tmp_path / "yarp.conf").write_text("127.0.0.1 10000 yarp\n")
    assert kind.enabled(unused) == "auto"
    named = Config.model_validate({"yarp": {"namespace": "/lab"}})
    assert kind.child_environment(named, {})["YARP_NAMESPACE"] == "/lab"


def test_ports_can_be_called_after_a_lack_of_threads() -> None:
    unused: Any = None
    caller, results = PortCaller(unused, "/robot/rpc", "", unused, 1000), list[bytes | CallError]()
    with no_threads("midspan-yarp-call"):
        for _ in range(MAX_CALLS + 1):
            caller.call(b"", results.append)
    assert {str(result) for result in results} == {"/robot/rpc cannot be called: can't start new thread"}
    assert len(results) == MAX_CALLS + 1


def test_call_reaches_a_server_that_was_restarted_since_the_last_check_of_the_connection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(loop, "_CHECK_PERIOD", 1000.0)
    naming: Any = LocalNaming()
    bottles: Any = SimpleNamespace(request_to_yarp=lambda request, _: request, reply_to_hub=lambda reply, _: reply)
    caller, results = PortCaller(naming, "/robot/rpc", "", bottles, 1000), list[bytes | CallError]()
    words = encode(["on"], Profile.YARP3)
    for count in (1, 2):
        server = PortCore("/robot/rpc", naming=naming, on_message=lambda message: message.reply(words))
        server.open()
        caller.call(words, results.append)
        until(lambda n=count: len(results) == n, "the call ends")
        until(lambda: caller._idle, "the connection is idle")
        server.close()
    caller.close()
    assert results == [words, words]
