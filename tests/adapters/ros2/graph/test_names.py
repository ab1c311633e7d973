"""Nodes of one name are reported."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest
from typing_extensions import override

from bridge.adapters.ros2.graph import names
from bridge.adapters.ros2.graph.names import NamesakeWatch
from bridge.concurrency import DelayedCalls
from bridge.hub.wire.qos import Qos
from bridge.routing.edge import Endpoint, Kind, MadeBy
from tests.adapters.ros2.conftest import RunningEdge
from tests.peers.peer import Peer
from tests.support.wait import until


class Later(DelayedCalls):
    """Calls nothing: the test does, and its clock jumps."""

    @override
    def every(self, seconds: float, call: Callable[[], object], first: float | None = None) -> None: ...


@pytest.fixture
def later() -> Iterator[DelayedCalls]:
    calls = Later("test-names")
    yield calls
    calls.close(1.0)


def server(number: int, node: str, service: str, made_by: MadeBy = MadeBy.NATIVE) -> Endpoint:
    return Endpoint(str(number), Kind.SERVER, service, "std_srvs/srv/Empty", Qos(), made_by, node=node)


def test_only_native_nodes_of_one_name_count(later: DelayedCalls, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(names, "LEASE_SECONDS", 0.0)
    ends = [
        *(server(number, "/cam", service) for number in range(3) for service in ("/cam/get", "/cam/set")),
        server(7, "/left", "/reset"), server(8, "/right", "/reset"),  # two nodes with one service
        server(9, "/mine", "/mine/get"), server(10, "/mine", "/mine/get", MadeBy.MIDSPAN),
        server(11, "", "/anonymous"), server(12, "", "/anonymous"),
    ]  # fmt: skip
    watch = NamesakeWatch(lambda: ends, later)
    watch.check()
    (text,) = watch.texts
    assert text.startswith("3 ROS 2 nodes are named /cam: a call, for example of /cam/get, is answered by any of them")


def test_a_killed_node_is_not_reported_beside_its_successor(
    later: DelayedCalls, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now = [100.0]
    monkeypatch.setattr(names, "time", SimpleNamespace(monotonic=lambda: now[0]))
    ends = [server(1, "/cam", "/cam/get"), server(2, "/cam", "/cam/get")]
    watch = NamesakeWatch(lambda: ends, later)
    watch.check()
    now[0] += 20.0
    watch.check()
    assert watch.texts == []
    first = ends.pop(0)
    watch.check()
    ends.append(first)
    for _ in range(4):
        watch.check()
        now[0] += 15.0
    assert len(watch.texts) == 1
    assert [r.getMessage() for r in caplog.records if r.name == names.__name__] == watch.texts


def test_nodes_of_one_name_are_reported_until_one_is_left(
    edge: RunningEdge, peer: Callable[..., Peer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(names, "LEASE_SECONDS", 0.0)
    watch = edge.edge._namesakes
    assert watch is not None
    first = peer("twin")
    first.ask("serve", service="/twin/first", type="std_srvs/Trigger", reply={})
    edge.until_seen("/twin/first", Kind.SERVER)
    watch.check()
    assert edge.edge.warnings() == []
    second = peer("twin")
    second.ask("serve", service="/twin/second", type="std_srvs/Trigger", reply={})

    def reported() -> bool:
        watch.check()
        return any("2 ROS 2 nodes are named /twin" in text for text in edge.edge.warnings())

    until(reported, "both are reported")
    second.stop()
    until(lambda: not reported(), "one is left")
