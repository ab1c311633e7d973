"""The choice of this node's name on a ROS 1 network: no live node loses its name."""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.adapters.ros1.graph import presence
from bridge.adapters.ros1.graph.membership import Membership
from bridge.adapters.ros1.graph.presence import Ledger, NodeEntry, is_alive
from bridge.adapters.ros1.graph.state import NAMESPACE, PRESENCE, MasterReader, MasterState
from bridge.adapters.ros1_peers import Call, ExhaustedError, RefusedError, Ros1Error, UnreachableError, XmlRpcClient
from tests.peers.ros1.network import RosMaster, needs_ros1

HOLDER = NodeEntry("owner", "first", "/midspan", "http://holder:1/", 7)
STATE = MasterState("run", "network", uris={HOLDER.node: HOLDER.uri})
REFUSED, SILENT = UnreachableError("refused", refused=True), UnreachableError("no answer in time")


def free_name() -> str:
    """Return the name that a second daemon's node would choose."""
    node, unused = cast("Any", SimpleNamespace(name="/midspan", uri="http://own:2/")), cast("Any", None)
    return Membership(node, "second", unused, unused, unused, simulated=False)._free_name(STATE, set())


def answer(monkeypatch: pytest.MonkeyPatch, answers: Sequence[int | Ros1Error]) -> list[str]:
    """Have the holder's node answer calls in this way; return the list of the calls."""
    calls, pending = list[str](), list(answers)

    def ask(uri: str, _seconds: float, method: str, *_params: object) -> int:
        calls.append(method)
        assert uri == HOLDER.uri
        result = pending.pop(0)
        if isinstance(result, Ros1Error):
            raise result
        return result

    monkeypatch.setattr(presence, "ask", ask)
    return calls


@pytest.mark.parametrize("answers", [[7], [SILENT, 7], [RefusedError("no such method")]])
def test_a_live_node_keeps_its_name(monkeypatch: pytest.MonkeyPatch, answers: list[int | Ros1Error]) -> None:
    """A call without an answer proves nothing: this process may have been suspended until its deadline had passed."""
    calls = answer(monkeypatch, answers)
    assert free_name() == "/midspan_second"
    assert len(calls) == len(answers)


@pytest.mark.parametrize("answers", [[REFUSED], [SILENT, SILENT], [SILENT, REFUSED]])
def test_the_name_of_a_dead_node_is_free(monkeypatch: pytest.MonkeyPatch, answers: list[int | Ros1Error]) -> None:
    calls = answer(monkeypatch, answers)
    assert free_name() == "/midspan"
    assert len(calls) == len(answers)


@pytest.mark.parametrize(("answers", "alive"), [([SILENT, 7], True), ([8], False), ([REFUSED], False)])
def test_a_predecessor_is_alive_if_it_is_the_same_process(
    monkeypatch: pytest.MonkeyPatch, answers: list[int | Ros1Error], *, alive: bool
) -> None:
    answer(monkeypatch, answers)
    assert is_alive("/midspan", HOLDER) is alive


def test_nodes_on_hosts_that_are_off_are_called_at_the_same_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Each call lasts a second without an answer."""
    (tmp_path / "ros1.json").write_text(json.dumps({"owner": "owner"}), encoding="utf-8")
    earlier = [NodeEntry("owner", "second", f"/earlier{n}", f"http://off:{n}/", n) for n in range(1, 4)]
    names = ["/midspan", "/midspan_second", "/midspan_second_2"]
    holders = {name: f"http://off:{n}/" for n, name in enumerate(names, 11)}
    state = MasterState("run", "network", uris=holders, presence={e.key: e.as_dict() for e in earlier})
    called = threading.Barrier(3)

    def ask(_uri: str, _seconds: float, _method: str, *_params: object) -> int:
        called.wait(20.0)
        return 99

    monkeypatch.setattr(presence, "ask", ask)
    node: Any = SimpleNamespace(name="/midspan", uri="http://own:2/", port=2)
    client: Any = SimpleNamespace(calls=lambda _calls: [None] * 2)
    reader: Any = SimpleNamespace(read=lambda: MasterState("run", "network"))
    Membership(node, "second", Ledger(tmp_path), client, reader, simulated=False).join(state)
    assert node.name == "/midspan_second_3"


def test_a_process_without_descriptors_decides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The master is read again later."""
    answer(monkeypatch, [ExhaustedError("no file descriptor left")])
    with pytest.raises(ExhaustedError):
        free_name()


class BusyClient(XmlRpcClient):
    """A client of a master on which another node joins after this node has read that `NAMESPACE` is empty."""

    def calls(self, calls: Sequence[Call]) -> list[Any]:
        answers = super().calls(calls)
        if calls == [("getParam", ("/midspan", NAMESPACE))] and answers == [{"nodes": {}}]:
            super().calls([("setParam", ("/other", f"{PRESENCE}/node_other", HOLDER.as_dict()))])
        return answers


@needs_ros1
def test_a_node_that_joins_while_the_last_one_leaves_keeps_its_entry(master: RosMaster, tmp_path: Path) -> None:
    client = BusyClient(master.uri, 20.0)
    node: Any = SimpleNamespace(name="/midspan", uri="http://127.0.0.1:1/", port=2)
    reader = MasterReader(client, node.name)
    membership = Membership(node, "daemon", Ledger(tmp_path), client, reader, simulated=False)
    membership.join(reader.read())
    membership.leave(client)
    membership.release(client)
    assert master.call("getParam", NAMESPACE) == {"nodes": {"node_other": HOLDER.as_dict()}}
    master.call("deleteParam", NAMESPACE)
    client.close()
