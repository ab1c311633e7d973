"""The node ``/rosout`` of the embedded master."""

from __future__ import annotations

from bridge.adapters.ros1.handshake import ORIGIN_FIELD, connect
from bridge.adapters.ros1.master.embedded import EmbeddedMaster


def test_collected_logs_count_as_native_so_that_they_are_bridged():
    master = EmbeddedMaster("127.0.0.1", 0)
    master.start()
    try:
        sock, header = connect("/reader", master.nodes()["/rosout"], "/rosout_agg", 5.0)
        sock.close()
    finally:
        master.close()
    assert header["type"] == "rosgraph_msgs/Log"
    assert header["callerid"] == "/rosout"
    assert ORIGIN_FIELD not in header
