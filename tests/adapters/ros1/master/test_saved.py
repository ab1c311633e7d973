"""The master's state file: restored after a restart, and never an obstacle to one."""

from __future__ import annotations

import math
import xmlrpc.client
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.ros1.master import saved
from bridge.adapters.ros1.master.api import MasterApi
from bridge.adapters.ros1.master.embedded import EmbeddedMaster
from tests.peers.ros1.outbox import RecordedCalls
from tests.support.wait import until

A, B = "http://host:1/", "http://host:2/"


def filled() -> MasterApi:
    api = MasterApi("", RecordedCalls())
    for method, *params in [
        ("registerPublisher", "/a", "/t", "std_msgs/String", A),
        ("registerPublisher", "/b", "/t", "std_msgs/String", B),
        ("registerSubscriber", "/b", "/u", "*", B),
        ("registerService", "/a", "/srv", "rosrpc://host:3", A),
        ("subscribeParam", "/b", B, "/p"),
        ("setParam", "/a", "/p", {"text": "päth \n<&>", "list": [1, 2.5, True, [], {}], "inf": math.inf}),
        ("setParam", "/a", "/bytes", xmlrpc.client.Binary(bytes(range(256)))),
        ("setParam", "/a", "/time", xmlrpc.client.DateTime("20261126T12:00:00")),
    ]:
        assert api.methods[method](*params)[0] == 1
    return api


def state(api: MasterApi) -> list[Any]:
    calls = ("getSystemState", "getTopicTypes", "getParamNames")
    named = (("lookupNode", "/b"), ("lookupService", "/srv"), ("getParam", "/"))
    return [*(api.methods[c]("/x") for c in calls), *(api.methods[c]("/x", name) for c, name in named)]


def test_all_state_is_restored(tmp_path: Path):
    file = tmp_path / "state.json"
    file.write_text(saved.dump(filled()))
    api = MasterApi("", RecordedCalls())
    assert saved.load(file, api)
    assert state(api) == state(filled())
    outbox = api._outbox
    assert isinstance(outbox, RecordedCalls)
    api.methods["setParam"]("/x", "/p/text", "new")
    assert outbox.pop() == [(B, "paramUpdate", "/p/text/", "new")]


@pytest.mark.parametrize(
    "text",
    [
        "", "{", "[]", "5", "{}", '{"version": 2}',
        '{"version": 1, "parameters": 5, "registrations": [], "types": {}}',
        '{"version": 1, "parameters": {"a": null}, "registrations": [], "types": {}}',
        '{"version": 1, "parameters": {}, "registrations": [["NOTHING", "a", "b", "c", "d"]], "types": {}}',
        '{"version": 1, "parameters": {}, "registrations": [["PUBLISHER"]], "types": {}}',
        '{"version": 1, "parameters": {}, "registrations": [], "types": []}',
        "[" * 100_000,
    ],
)  # fmt: skip
def test_a_damaged_file_is_reported_and_ignored(tmp_path: Path, text: str, caplog: pytest.LogCaptureFixture):
    file = tmp_path / "state.json"
    file.write_text(text)
    api = filled()
    before = state(api)
    assert not saved.load(file, api)
    assert state(api) == before
    assert "damaged" in caplog.text


def test_a_file_that_cannot_be_read_is_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    api = filled()
    assert not saved.load(tmp_path / "missing", api)
    assert caplog.text == ""
    assert not saved.load(tmp_path, api)
    assert "cannot read" in caplog.text


def test_a_master_writes_its_changes_and_restores_them(tmp_path: Path):
    file = tmp_path / "state.json"
    first = EmbeddedMaster("127.0.0.1", 0, state=file)
    first.start()
    run_id = first.api.parameters.get("/run_id")
    with xmlrpc.client.ServerProxy(first.uri) as proxy:
        proxy.registerPublisher("/node", "/t", "std_msgs/String", A)
        until(lambda: "std_msgs/String" in file.read_text() if file.exists() else False, "the file is written")
        proxy.setParam("/node", "~x", 7)  # type: ignore[misc]
    first.close()
    second = EmbeddedMaster("127.0.0.1", 0, state=file)
    second.start()
    with xmlrpc.client.ServerProxy(second.uri) as proxy:
        assert proxy.getParam("/x", "/node/x") == [1, "Parameter [/node/x]", 7]
        assert proxy.getParam("/x", "/run_id")[2] == run_id  # type: ignore[index]
        assert proxy.lookupNode("/x", "/node")[2] == A  # type: ignore[index]
    second.close()
