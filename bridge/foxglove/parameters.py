"""Parameters of the hub's ROS 2 nodes for the app, named ``/node.name``.

Parameters are read only while clients request them. The SDK expects immediate answers, on the threads that send, so
clients get the values that were read last; if older than `FRESH_SECONDS`, they are read again for the next request.
Changes made by others are not published, because the process could deadlock: ``publish_parameter_values`` of the SDK
0.30 takes a lock while it holds the GIL, but a thread with this lock waits for the GIL if a client subscribes then.
"""

from __future__ import annotations

import logging
import time
import xmlrpc.client
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from threading import Lock
from typing import Any

import foxglove

from bridge.adapters.ros1.parameters.values import NOT_SET, ParameterType, ParameterValue, UnrepresentableError, to_ros2
from bridge.client.services import ServiceClient
from bridge.foxglove.server import FoxgloveServer
from bridge.foxglove.visitors import Visitors
from bridge.hub.endpoints.calls import CallError
from bridge.messages.errors import ConversionError
from bridge.modules.host import Host

_log = logging.getLogger("midspan.foxglove")

FRESH_SECONDS = 1.0
WAIT_SECONDS = 0.5
"""Maximum wait of a first request for values, or of a change for its completion; only one waits at a time."""
IDLE_SECONDS = 60.0
"""Values that no client has requested for this long are discarded."""
MOST_NODES, MOST_PARAMETERS = 200, 5_000  # the parameters are those of one change; each node has at most a tenth
NODE_SECONDS = 5.0
"""A node that has not answered for this long is skipped."""

READY_TRIES, READY_SECONDS = 40, 0.02
"""Number and interval of the checks whether a new service client has discovered its server. The service is called then,
or after the last check."""

LIST, GET, SET = "ListParameters", "GetParameters", "SetParameters"
_SERVICES = {LIST: "list_parameters", GET: "get_parameters", SET: "set_parameters"}

Replied = Callable[[dict[str, Any] | CallError], None]


class Parameters:
    """The parameters of all nodes. `answer` and `change` are thread-safe; all else runs on the worker's thread."""

    def __init__(self, host: Host, server: FoxgloveServer, visitors: Visitors) -> None:
        self._host, self._server, self._visitors = host, server, visitors
        self._waiting = Lock()
        self._values: dict[str, dict[str, ParameterValue]] = {}  # by node; replaced, never changed
        self._asked = self._read = -IDLE_SECONDS
        self._reading: Future[None] | None = None
        self._clients: dict[tuple[str, str], ServiceClient] = {}

    # -- on the SDK's threads ------------------------------------------------------------------------------------------

    def answer(self, names: Sequence[str]) -> list[foxglove.Parameter]:
        """Return the known values of these parameters, or of all if ``names`` is empty."""
        now = time.monotonic()
        is_first, self._asked = now - self._read > IDLE_SECONDS, now
        if now - self._read > FRESH_SECONDS:
            self._await(lambda done: self._host.loop.post(partial(self._refresh, done)), wait=is_first)
        known = self._known()
        return [_foxglove_parameter(name, known[name]) for name in (names or sorted(known)) if name in known]

    def change(self, client: int, wanted: Sequence[foxglove.Parameter]) -> list[foxglove.Parameter]:
        """Set parameters on their nodes; return the values that are known after at most `WAIT_SECONDS`."""
        visitor = self._visitors.visitor_of(client)
        if visitor is None or not visitor.grant.may_drive:
            self._warn("you may read parameters, but not set them (see foxglove.drive, or your token's role)")
        else:
            values = {parameter.name: parameter.get_value() for parameter in wanted[:MOST_PARAMETERS]}
            _log.info("%s sets %s", visitor.who, ", ".join(values)[:500])
            self._asked = time.monotonic()
            self._await(lambda done: self._host.loop.post(partial(self._set, values, done)), wait=True)
        known = self._known()
        return [
            _foxglove_parameter(parameter.name, known[parameter.name])
            for parameter in wanted
            if parameter.name in known
        ]

    def _await(self, begin: Callable[[Future[None]], None], *, wait: bool) -> None:
        """Start an operation; if ``wait``, wait for it unless another call waits: at most one SDK thread may block."""
        done: Future[None] = Future()
        waits = wait and self._waiting.acquire(blocking=False)
        try:
            begin(done)
            if waits:
                done.result(WAIT_SECONDS)
        except TimeoutError:
            pass
        finally:
            if waits:
                self._waiting.release()

    def _known(self) -> dict[str, ParameterValue]:
        return {f"{node}.{name}": value for node, values in self._values.items() for name, value in values.items()}

    # -- on the worker's thread ----------------------------------------------------------------------------------------

    def _refresh(self, done: Future[None]) -> None:
        """Read all nodes' parameters, unless a read is in progress."""
        if self._reading is not None:
            self._reading.add_done_callback(lambda _: done.set_result(None))
            return
        self._reading = done
        nodes = sorted(
            end.topic.rpartition("/")[0]
            for end in self._host.node.hub.graph.servers()
            if end.type_name == f"rcl_interfaces/srv/{LIST}" and not end.own and end.topic.endswith(_SERVICES[LIST])
        )[:MOST_NODES]
        for key in [key for key in self._clients if key[0] not in nodes]:
            self._host.node.release(self._clients.pop(key))
        self._values = {node: values for node, values in self._values.items() if node in nodes}
        remaining = set(nodes)

        def on_read(node: str, values: dict[str, ParameterValue] | None) -> None:
            if node not in remaining:
                return
            remaining.discard(node)
            if values is not None:
                self._values = {**self._values, node: values}
            if not remaining:
                self._finish(done)

        def give_up() -> None:
            for node in list(remaining):
                on_read(node, None)

        self._host.loop.after(NODE_SECONDS, give_up)  # first, so that an error below does not end all reading
        for node in nodes:
            self._read_node(node, partial(on_read, node))
        if not nodes:
            self._finish(done)

    def _finish(self, done: Future[None]) -> None:
        self._read, self._reading = time.monotonic(), None
        done.set_result(None)

    def _read_node(self, node: str, on_read: Callable[[dict[str, ParameterValue] | None], None]) -> None:
        def on_names(reply: dict[str, Any] | CallError) -> None:
            if isinstance(reply, CallError):
                on_read(None)
                return
            names = list(reply["result"]["names"])[: MOST_PARAMETERS // 10]
            self._call(node, GET, {"names": names}, partial(on_values, names))

        def on_values(names: list[str], reply: dict[str, Any] | CallError) -> None:
            if isinstance(reply, CallError) or len(reply["values"]) != len(names):
                on_read(None)
                return
            values = {name: ParameterValue.read(value) for name, value in zip(names, reply["values"], strict=True)}
            on_read({name: value for name, value in values.items() if value != NOT_SET})

        self._call(node, LIST, {"prefixes": [], "depth": 0}, on_names)

    def _set(self, values: dict[str, Any], done: Future[None], *, is_read: bool = False) -> None:
        """Set the parameters on each node, then read all its parameters; first read those that are not known yet."""
        if not (is_read or values.keys() <= self._known().keys()):
            read = Future[None]()
            read.add_done_callback(lambda _: self._set(values, done, is_read=True))
            self._refresh(read)
            return
        by_node: dict[str, dict[str, ParameterValue]] = {}
        for full, value in values.items():
            node, name, before = self._find(full)
            try:
                by_node.setdefault(node, {})[name] = value_of_kind(value, before)
            except UnrepresentableError as err:
                self._warn(f"{full}: {err}")
        by_node.pop("", None)
        remaining = set(by_node)
        for node, new_values in by_node.items():
            self._set_node(node, new_values, partial(self._set_done, remaining, node, done))
        if not remaining:
            done.set_result(None)

    def _find(self, full: str) -> tuple[str, str, ParameterValue]:
        """Return the node, name and value of a parameter; for an unknown parameter, warn and return the node ""."""
        for node, values in self._values.items():
            name = full.removeprefix(f"{node}.")
            if name in values and name != full:
                return node, name, values[name]
        self._warn(f"{full[:200]}: no node on the hub has this parameter")
        return "", full, NOT_SET

    def _set_node(self, node: str, new_values: dict[str, ParameterValue], done: Callable[[], None]) -> None:
        def on_reply(reply: dict[str, Any] | CallError) -> None:
            if isinstance(reply, CallError):
                self._warn(f"{node} did not set its parameters: {reply}")
            else:
                for name, result in zip(new_values, reply["results"], strict=False):
                    if not result["successful"]:
                        self._warn(f"{node} refuses {name}: {result['reason'] or 'no reason given'}")
            self._read_node(node, on_read)

        def on_read(values: dict[str, ParameterValue] | None) -> None:
            if values is not None:
                self._values = {**self._values, node: values}
            done()

        parameters = [{"name": name, "value": new.message()} for name, new in new_values.items()]
        self._call(node, SET, {"parameters": parameters}, on_reply)

    def _set_done(self, remaining: set[str], node: str, done: Future[None]) -> None:
        remaining.discard(node)
        if not remaining and not done.done():
            done.set_result(None)

    def _call(self, node: str, kind: str, request: dict[str, Any], replied: Replied, tries: int = READY_TRIES) -> None:
        key = node, kind
        client = self._clients.get(key)
        if client is None:
            name = f"{node}/{_SERVICES[kind]}"
            client = self._clients[key] = self._host.node.client(name, f"rcl_interfaces/srv/{kind}")
        if not client.ready and tries:  # the client is new
            self._host.loop.after(READY_SECONDS, lambda: self._call(node, kind, request, replied, tries - 1))
            return
        try:
            client.call(request, replied)
        except ConversionError as err:
            replied(CallError(str(err)))

    def tick(self) -> None:
        """Discard values that clients no longer request."""
        if self._clients and time.monotonic() - self._asked > IDLE_SECONDS and self._reading is None:
            self.close()

    def _warn(self, text: str) -> None:
        self._server.warn(text, "parameters")

    def close(self) -> None:
        """Close the service clients of all nodes, and discard the values."""
        clients, self._clients, self._values, self._read = self._clients, {}, {}, -IDLE_SECONDS
        for client in clients.values():
            self._host.node.release(client)


def value_of_kind(value: Any, before: ParameterValue) -> ParameterValue:
    """Convert a client's value to the parameter's type; raises `UnrepresentableError`."""
    return to_ros2(xmlrpc.client.Binary(value) if isinstance(value, bytes) else value, before.kind)


def _foxglove_parameter(name: str, value: ParameterValue) -> foxglove.Parameter:
    floats = {
        ParameterType.DOUBLE: foxglove.ParameterType.Float64,
        ParameterType.DOUBLE_ARRAY: foxglove.ParameterType.Float64Array,
    }
    if value.kind in floats:
        return foxglove.Parameter(name, value=value.content, type=floats[value.kind])
    return foxglove.Parameter(name, value=value.content)
