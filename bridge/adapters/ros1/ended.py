"""Our publications that ended: a subscriber that was told of one a moment before, and comes now, is greeted and let go.

rospy never tries a publisher again whose connection header was an error, or did not come: the connection that failed
stays in its list for good, and while one of a publisher is in there, no master's word of that publisher counts
(``robust_connect_subscriber`` of ``tcpros_pubsub.py`` and ``_connect_topic`` of ``masterslave.py``, rospy 1.15.15; seen
with workers that were killed one after the other). Such a subscriber would hear nothing of a topic that we publish
again later, until one of the two is restarted. A connection that ends after its header is removed as usual.

rospy is one per process, and so are its publications.
"""

from __future__ import annotations

from collections.abc import Mapping
from threading import Lock

_MOST = 2000
"""Topics that are remembered; of more, those that ended first are forgotten."""

_ANY = "*"

_lock = Lock()
_headers: dict[str, dict[str, str]] = {}


def note(topic: str, header: Mapping[str, str]) -> None:
    """A publication ends; ``header`` is what its subscribers got as connection header."""
    with _lock:
        _headers.pop(topic, None)
        _headers[topic] = dict(header)
        if len(_headers) > _MOST:
            del _headers[next(iter(_headers))]


def farewell(header: Mapping[str, str]) -> dict[str, str] | None:
    """The connection header for one who comes too late, given its own; None where that is no subscriber of ours."""
    with _lock:
        found = _headers.get(header.get("topic", ""))
    return found if found is not None and header.get("md5sum") in {_ANY, found["md5sum"]} else None
