"""A zenoh end: raw samples with an attachment as large as rmw_zenoh's, between peers with a direct link.

Usage: ``python -m benchmarks.latency.zenoh_end ROUTER SHARED_MEMORY``; sessions are configured like the daemon's.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import zenoh
from typing_extensions import override

from benchmarks.latency.end import End
from bridge.hub.wire.keys import ATTACHMENT_SIZE
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, session_tree


class ZenohEnd(End):
    """A program with one zenoh session.

    Args:
        peer: endpoint of a router or another peer; None if the other peer connects.
        shared_memory: the hub's setting.
        listen: endpoint to listen on; "": any.
        express: whether each sample is sent in a separate packet.
    """

    def __init__(self, peer: str | None, *, shared_memory: bool, listen: str = "", express: bool = True) -> None:
        super().__init__()
        self._express = express
        tree = session_tree(peer, shared_memory=shared_memory, max_payload=MAX_PAYLOAD)
        if listen:
            tree["listen"] = {"endpoints": [listen]}
        self._session = zenoh.open(make_config(tree, None))
        self._endpoints: list[Any] = []

    @override
    def publisher(self, topic: str, type_: str) -> tuple[Callable[[bytes], None], Callable[[], bool]]:
        publisher = self._session.declare_publisher(
            topic.strip("/"), congestion_control=zenoh.CongestionControl.DROP, express=self._express
        )
        self._endpoints.append(publisher)
        attached = bytes(ATTACHMENT_SIZE)
        return lambda payload: publisher.put(payload, attachment=attached), lambda: self._is_linked(publisher)

    @override
    def listen(self, topic: str, type_: str, on_message: Callable[[bytes], None]) -> None:
        handler: Any = zenoh.handlers.Callback(lambda sample: on_message(sample.payload.to_bytes()), indirect=False)
        self._endpoints.append(self._session.declare_subscriber(topic.strip("/"), handler))

    @override
    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    def _is_linked(self, publisher: Any) -> bool:
        """Return whether the listener is connected by a direct link, not only through the router."""
        return bool(publisher.matching_status.matching) and len(self._session.info.peers_zid()) > 0


if __name__ == "__main__":
    ZenohEnd(sys.argv[1], shared_memory=sys.argv[2] == "1").run()
