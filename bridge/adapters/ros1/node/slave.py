"""The slave API of this node (https://wiki.ros.org/ROS/Slave_API): XML-RPC methods for the master, peers and tools.

Each method has the caller's name as its first parameter, and returns ``[code, status message, value]``: code 1 is
success, 0 a failure, -1 an invalid call. As with rospy, an invalid call returns the method's default value.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from bridge.adapters.ros1.topics.book import TopicBook

Answer = Sequence[Any]

REPEATING_MASTER = "/master/repeat"
"""The caller's name in a ``paramUpdate`` by which Midspan's own master repeats values after it has restarted. For other
updates it is ``/master``, as with ``rosmaster``. rospy and roscpp ignore the name."""

_TCPROS = "TCPROS"


@dataclass(frozen=True, slots=True)
class ParameterUpdate:
    """An update of a parameter.

    Attributes:
        key: the parameter's name, with or without a trailing slash.
        repeated: whether the master repeats the value after it has restarted; otherwise a program has set it.
    """

    key: str
    repeated: bool = False


class _InvalidCallError(Exception):
    """A parameter is invalid; the text has the reason."""


@dataclass(frozen=True, slots=True)
class SlaveState:
    """The node that the API describes; the callables return current values.

    Attributes:
        name: the node's name.
        uri: the node's XML-RPC address.
        master: the master's address.
        tcpros: the host and port for subscribers.
        book: the node's topics.
        calls: the number of calls to the node's services, bytes received and bytes sent.
    """

    name: Callable[[], str]
    uri: Callable[[], str]
    master: str
    tcpros: Callable[[], tuple[str, int]]
    book: TopicBook
    calls: Callable[[], list[int | float]]


@dataclass(frozen=True, slots=True)
class SlaveEvents:
    """The callbacks for calls of the API, on the server's threads.

    Attributes:
        publishers_changed: called when the publishers of a subscribed topic have changed.
        parameter_changed: called with the update of a parameter; returns False if it is not subscribed.
        shutdown: called with the reason when another node, the master or a user requests the node's shutdown.
    """

    publishers_changed: Callable[[], None]
    parameter_changed: Callable[[ParameterUpdate], bool]
    shutdown: Callable[[str], None]


class SlaveApi:
    """The methods of the API, by name in `methods`."""

    def __init__(self, state: SlaveState, events: SlaveEvents) -> None:
        self._state, self._events = state, events
        book = state.book
        self.methods: Mapping[str, Callable[..., Answer]] = {
            "getBusStats": _method([], lambda _: (1, "", [*book.bus_stats(), state.calls()])),
            "getBusInfo": _method([], lambda _: (1, "bus info", book.bus_info())),
            "getMasterUri": _method("", lambda _: (1, state.master, state.master)),
            "shutdown": _method(0, self._shutdown, 0, 1),
            "getPid": _method(-1, lambda _: (1, "", os.getpid())),
            "getSubscriptions": _method([], lambda _: (1, "subscriptions", _pairs(book.subscriptions()))),
            "getPublications": _method([], lambda _: (1, "publications", _pairs(book.publications()))),
            "paramUpdate": _method(-1, self._parameter_update, 2),
            "publisherUpdate": _method(-1, self._publisher_update, 2),
            "requestTopic": _method([], self._request_topic, 2),
            "getUri": _method("", lambda _: (1, "", state.uri())),
            "getName": _method("", lambda _: (1, "", state.name())),
        }

    def _shutdown(self, caller: str, message: object = "") -> Answer:
        reason = f": {message}" if isinstance(message, str) and message else ""
        self._events.shutdown(f"{caller} requested this node's shutdown{reason}")
        return 1, "shutdown", 0

    def _parameter_update(self, caller: str, key: object, _value: object) -> Answer:
        # the value is read again, since several updates may arrive in any order
        update = ParameterUpdate(_text(key, "parameter_key"), repeated=caller == REPEATING_MASTER)
        return (1, "", 0) if self._events.parameter_changed(update) else (-1, "not subscribed", 0)

    def _publisher_update(self, caller: str, topic: object, publishers: object) -> Answer:
        _resolved(caller, topic)
        if not isinstance(publishers, list) or not all(map(_is_uri, publishers)):
            raise _InvalidCallError("publishers is not a list of URIs")
        self._events.publishers_changed()  # the master is read again, since several updates may arrive in any order
        return 1, "", 0

    def _request_topic(self, caller: str, topic: object, protocols: object) -> Answer:
        name = _resolved(caller, topic)
        if not isinstance(protocols, list) or not protocols:
            raise _InvalidCallError("protocols is not a list of protocols")
        if name not in self._state.book.publications():
            return -1, f"Not a publisher of [{name}]", []
        offered = [p[0] for p in protocols if isinstance(p, list) and p]
        if _TCPROS not in offered:
            others = ", ".join(str(p)[:40] for p in offered[:5]) or "the requested ones"
            return 0, f"no supported protocol implementations: this node has {_TCPROS}, not {others}", []
        host, port = self._state.tcpros()
        return 1, f"ready on {host}:{port}", [_TCPROS, host, port]


def _method(
    default: object, function: Callable[..., Answer], needed: int = 0, optional: int = 0
) -> Callable[..., Answer]:
    """Return a method of the API, which validates the caller's name and the number of parameters.

    ``needed`` and ``optional`` are numbers of parameters after the caller's name; ``default`` is the value returned if
    the call is invalid.
    """

    def call(*params: object) -> Answer:
        if not params:
            return -1, "missing required caller_id parameter", default
        if not needed <= len(params) - 1 <= needed + optional:
            wanted = " or ".join(str(count + 1) for count in range(needed, needed + optional + 1))
            return -1, f"Error: bad call arity: {len(params)} parameters, not {wanted}", default
        if not isinstance(params[0], str):
            return -1, "caller_id must be a string", default
        try:
            return function(*params)
        except _InvalidCallError as err:
            return -1, f"ERROR: {err}", default

    return call


def _pairs(topics: Mapping[str, str]) -> list[list[str]]:
    return [[topic, name] for topic, name in topics.items()]


def _text(value: object, what: str) -> str:
    if not isinstance(value, str) or not value:
        raise _InvalidCallError(f"{what} is not a non-empty string")
    return value


def _resolved(caller: str, topic: object) -> str:
    """Return a topic's global name; a relative one is in the caller's namespace."""
    name = _text(topic, "topic")
    return name if name.startswith("/") else f"{caller.rpartition('/')[0]}/{name}"


def _is_uri(value: object) -> bool:
    try:
        parts = urlsplit(value) if isinstance(value, str) else None
    except ValueError:
        return False
    return parts is not None and bool(parts.scheme and parts.netloc)
