"""An end on zenoh: raw samples with an attachment as large as rmw_zenoh's, between peers with a direct link.

Usage: ``python -m benchmarks.latency.zenoh_end ROUTER SHARED_MEMORY``; sessions are configured as the daemon's own.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import zenoh

from benchmarks.latency.end import End
from bridge.hub.wire.keys import ATTACHMENT_SIZE
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, session_tree


class ZenohEnd(End):
    """One session.

    Args:
        peer: the endpoint of a router, or of another peer; None where this one is listened for.
        shared_memory: the hub's setting.
        listen: the endpoint on which this one listens, "" for any.
        express: whether each sample goes in a packet of its own.
    """

    def __init__(self, peer: str | None, *, shared_memory: bool, listen: str = "", express: bool = True) -> None:
        super().__init__()
        self._express = express
        tree = session_tree(peer, shared_memory=shared_memory, max_payload=MAX_PAYLOAD)
        if listen:
            tree["listen"] = {"endpoints": [listen]}
        self._session = zenoh.open(make_config(tree, None))
        self._endpoints: list[Any] = []

    def publisher(self, topic: str, type_: str) -> tuple[Callable[[bytes], None], Callable[[], bool]]:  # noqa: ARG002
        publisher = self._session.declare_publisher(
            topic.strip("/"), congestion_control=zenoh.CongestionControl.DROP, express=self._express
        )
        self._endpoints.append(publisher)
        attached = bytes(ATTACHMENT_SIZE)
        return lambda payload: publisher.put(payload, attachment=attached), lambda: self._is_linked(publisher)

    def listen(self, topic: str, type_: str, heard: Callable[[bytes], None]) -> None:  # noqa: ARG002
        handler: Any = zenoh.handlers.Callback(lambda sample: heard(sample.payload.to_bytes()), indirect=False)
        self._endpoints.append(self._session.declare_subscriber(topic.strip("/"), handler))

    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    def _is_linked(self, publisher: Any) -> bool:
        """Whether the listener is there, and on a link of its own rather than behind the router."""
        return bool(publisher.matching_status.matching) and len(self._session.info.peers_zid()) > 0


if __name__ == "__main__":
    ZenohEnd(sys.argv[1], shared_memory=sys.argv[2] == "1").run()
