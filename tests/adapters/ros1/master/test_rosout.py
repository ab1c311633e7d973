"""The node ``/rosout`` of the embedded master."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.adapters.ros1.handshake import ORIGIN_FIELD, connect
from bridge.adapters.ros1.master import rosout
from bridge.adapters.ros1.master.api import MasterApi
from bridge.adapters.ros1.master.embedded import EmbeddedMaster
from bridge.adapters.ros1.master.rosout import LOG, RosoutNode, is_elsewhere
from bridge.adapters.ros1.xmlrpc import XmlRpcServer
from bridge.adapters.ros1_peers import ask
from tests.peers.ros1.outbox import RecordedCalls


def test_collected_logs_count_as_native_so_that_they_are_bridged():
    master = EmbeddedMaster("127.0.0.1", 0)
    master.start()
    try:
        sock, header = connect("/reader", master.nodes()["/rosout"], "/rosout_agg", 40.0)
        sock.close()
    finally:
        master.close()
    assert header["type"] == "rosgraph_msgs/Log"
    assert header["callerid"] == "/rosout"
    assert ORIGIN_FIELD not in header


def test_a_rosout_that_registers_first_keeps_the_name():
    api = MasterApi("", RecordedCalls())
    node = RosoutNode(api, "http://127.0.0.1:1/", "127.0.0.1")
    api.methods["registerSubscriber"]("/rosout", "/rosout", LOG.name, "http://127.0.0.1:2/")
    node.start()
    assert api.methods["lookupNode"]("/test", "/rosout")[2] == "http://127.0.0.1:2/"
    assert api.methods["getSystemState"]("/test")[2] == [[], [["/rosout", ["/rosout"]]], []]


@pytest.mark.parametrize(
    ("publications", "elsewhere"),
    [
        ([{"a": 1}], False),
        ([{"a": 1}, ["/rosout_agg", "rosgraph_msgs/Log"]], True),
        ([[]], False),
        (7, False),
    ],
)
def test_another_rosout_is_detected_by_its_publications(
    monkeypatch: pytest.MonkeyPatch, publications: Any, elsewhere: bool
):
    """Since Python 3.12, in which slices are hashable, slicing a dictionary raises `KeyError`, not `TypeError`."""
    # a node that does not answer in time counts as dead, but here both ends may stand still for a moment
    monkeypatch.setattr(rosout, "ask", lambda uri, _seconds, *call: ask(uri, 40.0, *call))
    server = XmlRpcServer({"getPublications": lambda _caller: [1, "", publications]})
    server.start()
    try:
        api = MasterApi("", RecordedCalls())
        uri = f"http://127.0.0.1:{server.port}/"
        api.methods["registerPublisher"]("/rosout", "/rosout_agg", "rosgraph_msgs/Log", uri)
        assert is_elsewhere(api) == elsewhere
    finally:
        server.close()
