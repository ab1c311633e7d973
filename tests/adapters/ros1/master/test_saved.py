"""The master's state file is restored after a restart, and never prevents one."""

from __future__ import annotations

import math
import threading
import xmlrpc.client
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.ros1.master import saved
from bridge.adapters.ros1.master.api import MasterApi
from bridge.adapters.ros1.master.embedded import EmbeddedMaster
from tests.peers.ros1.fake_node import FakeNode
from tests.peers.ros1.outbox import RecordedCalls
from tests.support.wait import until

A, B = "http://host:1/", "http://host:2/"


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a master that stops on a busy machine wait until its state is written."""
    monkeypatch.setattr(saved, "_JOIN_SECONDS", 60.0)


def filled() -> MasterApi:
    api = MasterApi("", RecordedCalls())
    method: str
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
def test_an_invalid_file_is_reported_and_renamed(tmp_path: Path, text: str, caplog: pytest.LogCaptureFixture):
    file = tmp_path / "state.json"
    file.write_text(text)
    api = filled()
    before = state(api)
    assert not saved.load(file, api)
    assert state(api) == before
    assert "invalid state file" in caplog.text
    assert not file.exists()
    assert (tmp_path / "state.json.invalid").read_text() == text


def test_a_file_that_cannot_be_read_is_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    api = filled()
    assert not saved.load(tmp_path / "missing", api)
    assert "previous state" not in caplog.text  # threads of earlier tests may still log
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


def test_the_reachability_of_nodes_is_restored(tmp_path: Path):
    file, api = tmp_path / "state.json", filled()
    api.set_reachable("/b", B)
    api.set_reachable("/a", B)  # this is not the node's address
    file.write_text(saved.dump(api))
    restored = MasterApi("", RecordedCalls())
    assert saved.load(file, restored)
    assert {name: node.reachable for name, node in restored.registrations.nodes.items()} == {"/a": False, "/b": True}


class Disk:
    """Replaces `keep`: a write waits for ``ready``, and fails while ``full`` is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.writes: list[str] = []
        self.ready, self.full = threading.Event(), False
        self.ready.set()
        monkeypatch.setattr(saved, "keep", self._keep)
        monkeypatch.setattr(saved, "_PAUSE", 0.01)
        monkeypatch.setattr(saved, "_FAILED_PAUSE", 0.01)

    def _keep(self, _file: Path, text: str, _loss: str) -> bool:
        self.writes.append(text)
        assert self.ready.wait(30)
        return not self.full


def test_a_change_during_the_last_write_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    disk, api = Disk(monkeypatch), filled()
    disk.ready.clear()
    writer = saved.StateWriter(tmp_path / "state.json", api)
    writer.start()
    writer.changed()
    until(lambda: disk.writes, "the first write has begun")
    api.methods["setParam"]("/a", "/last", 1)
    writer.changed()
    closing = threading.Thread(target=writer.close)
    closing.start()
    until(writer._stopping.is_set, "the master stops")
    disk.ready.set()
    closing.join()
    assert '"last": 1' in disk.writes[-1]


def test_a_write_to_a_full_disk_is_repeated_without_another_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    disk = Disk(monkeypatch)
    disk.full = True
    writer = saved.StateWriter(tmp_path / "state.json", filled())
    writer.start()
    writer.changed()
    until(lambda: len(disk.writes) >= 3, "the write is retried")
    disk.full = False
    writer.close()


def test_subscribers_receive_after_a_restart_what_the_previous_master_had_queued(tmp_path: Path):
    subscriber = FakeNode()
    subscriber.answers.clear()
    first = EmbeddedMaster("127.0.0.1", 0, state=tmp_path / "state.json", rosout=False)
    first.start()
    call = first.api.methods
    call["registerSubscriber"]("/sub", "/t", "std_msgs/String", subscriber.api)
    call["subscribeParam"]("/sub", subscriber.api, "/p")
    call["registerSubscriber"]("/sub", "/busy", "*", subscriber.api)
    call["registerPublisher"]("/a", "/busy", "std_msgs/String", A)
    until(lambda: first.calls.waiting == 0, "the subscriber is busy with a call")
    call["registerPublisher"]("/a", "/t", "std_msgs/String", A)
    call["setParam"]("/a", "/p", 5)
    first.close()
    subscriber.answers.set()
    second = EmbeddedMaster("127.0.0.1", 0, state=tmp_path / "state.json", rosout=False)
    second.start()
    until(lambda: ("publisherUpdate", "/t", [A]) in subscriber.calls, "the subscriber gets the publisher")
    until(lambda: ("paramUpdate", "/p/", 5) in subscriber.calls, "the subscriber gets the parameter")
    second.close()
    subscriber.close()


def test_the_node_that_has_the_port_of_a_killed_masters_rosout_is_not_shut_down(tmp_path: Path):
    file, node = tmp_path / "state.json", FakeNode()
    api = MasterApi("", RecordedCalls())
    api.methods["registerPublisher"]("/rosout", "/rosout_agg", "rosgraph_msgs/Log", node.api)
    file.write_text(saved.dump(api))
    master = EmbeddedMaster("127.0.0.1", 0, state=file)
    master.start()
    assert master.nodes()["/rosout"] != node.api
    master.api.methods["registerSubscriber"]("/node", "/t", "*", node.api)
    master.api.methods["registerPublisher"]("/a", "/t", "std_msgs/String", A)
    until(lambda: any(call[0] == "publisherUpdate" for call in node.calls), "the restored master's calls are made")
    assert not any(call[0] == "shutdown" for call in node.calls)
    master.close()
    node.close()
