"""ROS 1's parameter server, through the master's API (wiki.ros.org/ROS/Parameter Server API)."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bridge.adapters.ros1.namespaces import delete_empty
from bridge.adapters.ros1.parameters.values import Unreadable
from bridge.adapters.ros1_peers import Call, RefusedError, Ros1Error, Ros1ProtocolError, XmlRpcClient
from bridge.hub.endpoints.calls import Done
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from bridge.messages.services import ServiceCodec

_TIMEOUT = 2.0
_STOP_TIMEOUT = 0.5
_BATCH = 200


def copies_parameter(owner: str) -> str:
    """Return the name of the parameter that lists a daemon's copies; ``owner`` is the daemon's id in its state folder.

    The list is on the master because, like the copies, it must outlive a killed process and end with the master.
    """
    return f"/midspan/parameters/daemon_{owner}"


_NAMESPACES = "/midspan/namespaces"


def namespaces_parameter(owner: str) -> str:
    """Return the name of the parameter that lists the namespaces that a daemon's copies have created."""
    return f"{_NAMESPACES}/daemon_{owner}"


def _names(listed: object) -> frozenset[str]:
    return frozenset(name for name in listed if isinstance(name, str)) if isinstance(listed, list) else frozenset()


_UNREADABLE = (RefusedError, Ros1ProtocolError)
"""Errors of a call whose response the master cannot encode, or whose response is invalid."""


def _unreadable(reason: str) -> Unreadable:
    return Unreadable(f"its value cannot be read from the master: {reason}")


def _tree(key: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the namespace ``key`` with these values, given by their full names."""
    root: dict[str, Any] = {}
    for name, value in values.items():
        *above, last = name.removeprefix(f"{key}/").split("/")
        level = root
        for part in above:
            level = level.setdefault(part, {})
        level[last] = value
    return root


class TakenNames:
    """Names on the parameter server that have values, and the namespaces that contain them."""

    def __init__(self, names: Iterable[str]) -> None:
        self._names: set[str] = set()
        self._namespaces: set[str] = set()
        for name in names:
            self.add(name)

    def add(self, name: str) -> None:
        """Add a name that gets a value."""
        self._names.add(name)
        self._namespaces.update(_above(name))

    def __contains__(self, name: str) -> bool:
        """Return whether a name has a value, or is a namespace with values."""
        return name in self._names or name in self._namespaces

    def obstacle(self, name: str) -> str:
        """Return why setting a name would overwrite other names' values; "" if it would not."""
        if name in self._namespaces:
            return f"{name} is a namespace in ROS 1"
        above = next((outer for outer in _above(name) if outer in self._names), None)
        return f"{above} has a value, and ROS 1 does not allow names below it" if above else ""


def _above(name: str) -> list[str]:
    """Return the names above a name: ``/a`` and ``/a/b`` for ``/a/b/c``."""
    return [name[:at] for at in range(1, len(name)) if name[at] == "/"]


class ParameterServer:
    """A master's parameter server; not thread-safe. Methods raise `Ros1Error`.

    ``slave`` is this node's XML-RPC address, ``owner`` this daemon's identity on the master.

    Attributes:
        copies: names of the copies of ROS 2 parameters that this daemon has set, including those of earlier processes.
        namespaces: names of the namespaces that did not exist before these copies.
    """

    def __init__(self, uri: str, caller: Callable[[], str], slave: str, owner: str) -> None:
        self._uri, self._caller, self._slave, self._owner = uri, caller, slave, owner
        self._client = XmlRpcClient(uri, _TIMEOUT)
        self._watched: set[str] = set()
        self.copies: frozenset[str] = frozenset()
        self.namespaces: frozenset[str] = frozenset()

    def watch(self, keys: Sequence[str]) -> dict[str, Any]:
        """Read parameters or namespaces ({} if not set), and subscribe to changes of them and of the keys below them.

        A restarted master has no subscriptions, so each call subscribes again. A value that the master cannot send, or
        that is nested too deeply, becomes `Unreadable`.
        """
        self._watched |= set(keys)
        me = self._caller()
        calls: list[Call] = [("subscribeParam", (me, self._slave, key)) for key in keys]
        try:
            *values, copies, namespaces = self._client.calls([*calls, *self._lists()])
        except _UNREADABLE:  # one such value makes the whole response invalid
            copies, namespaces = self._client.calls(self._lists())
            values = [self._read_one(call) for call in calls]
        self.copies, self.namespaces = _names(copies), _names(namespaces)
        return dict(zip(keys, values, strict=True))

    def _read_one(self, call: Call) -> Any:
        """Make one call; if a value below its key is unreadable, read the others without it."""
        method, params = call
        try:
            return self._client.call(method, *params)
        except _UNREADABLE as err:
            key, reason = params[-1], str(err)
        names = [name for name in self._client.call("getParamNames", self._caller()) if name.startswith(f"{key}/")]
        return _tree(key, self._read_apart(names)) if names else _unreadable(reason)

    def _read_apart(self, names: Sequence[str]) -> dict[str, Any]:
        """Read parameters, and divide them until only the unreadable ones are missing."""
        me = self._caller()
        try:
            values = self._client.calls([("getParam", (me, name)) for name in names])
        except _UNREADABLE as err:
            if len(names) == 1:
                return {names[0]: _unreadable(str(err))}
            half = len(names) // 2
            return self._read_apart(names[:half]) | self._read_apart(names[half:])
        return {name: value for name, value in zip(names, values, strict=True) if value is not None}

    def taken(self, without: Collection[str] = ()) -> TakenNames:
        """Return the names that have values, except the names ``without``."""
        names = self._client.call("getParamNames", self._caller())
        return TakenNames(name for name in names if name not in without)

    def write(self, values: Mapping[str, Any]) -> list[str]:
        """Set parameters, or delete them if their value is None; return the names that the master did not set."""
        me = self._caller()
        calls: list[Call] = [
            ("deleteParam", (me, key)) if value is None else ("setParam", (me, key, value))
            for key, value in values.items()
        ]
        answers: list[Any] = []
        for at in range(0, len(calls), _BATCH):
            answers += self._client.calls(calls[at : at + _BATCH])
        pairs = zip(values.items(), answers, strict=True)
        return [key for (key, value), answer in pairs if value is not None and answer is None]

    def copy(self, values: Mapping[str, Any], copies: Collection[str]) -> list[str]:
        """Write like `write`, and list ``copies`` for `close` or, after a crash, for the next process.

        A name is listed before it is set, and stays listed until it is deleted; a name that cannot be listed is not
        set.
        """
        listed = frozenset(copies)
        self._list_namespaces(self.namespaces | self._own_namespaces(listed - self.copies))
        self._list(self.copies | listed)
        unlisted = [key for key, value in values.items() if value is not None and key not in self.copies]
        refused = self.write({key: value for key, value in values.items() if key not in unlisted})
        self._list(listed)
        if self.namespaces and None in values.values():
            self._delete_empty()
        return [*unlisted, *refused]

    def _lists(self) -> list[Call]:
        """Return the calls that read this daemon's lists."""
        return [("getParam", (self._caller(), of(self._owner))) for of in (copies_parameter, namespaces_parameter)]

    def _list(self, copies: frozenset[str]) -> None:
        if copies != self.copies and not self.write({copies_parameter(self._owner): sorted(copies) or None}):
            self.copies = copies

    def _list_namespaces(self, names: frozenset[str]) -> None:
        if names != self.namespaces and not self.write({namespaces_parameter(self._owner): sorted(names) or None}):
            self.namespaces = names

    def _own_namespaces(self, new: Collection[str]) -> frozenset[str]:
        """Return the namespaces of new copies that the master lacks, or that another Midspan has listed."""
        names = sorted({outer for key in new for outer in _above(key)} - self.namespaces)
        if not names:
            return frozenset()
        me = self._caller()
        checks: list[Call] = [("hasParam", (me, name)) for name in names]
        *present, lists = self._client.calls([*checks, ("getParam", (me, _NAMESPACES))])
        listed = frozenset[str]().union(*map(_names, lists.values() if isinstance(lists, dict) else ()))
        return frozenset(name for name, exists in zip(names, present, strict=True) if not exists or name in listed)

    def _delete_empty(self) -> None:
        """Delete the listed namespaces without values, which a master keeps."""
        taken = self.taken()
        empty = frozenset(name for name in self.namespaces if name not in taken)
        delete_empty(self._client, self._caller(), empty)
        self._list_namespaces(self.namespaces - empty)

    def close(self) -> None:
        """Delete the listed copies and the namespaces that only they needed, and unsubscribe."""
        me = self._caller()
        self._client.close()
        self._client = XmlRpcClient(self._uri, _STOP_TIMEOUT)
        with contextlib.closing(self._client), contextlib.suppress(Ros1Error):
            unsubscribe: list[Call] = [("unsubscribeParam", (me, self._slave, key)) for key in sorted(self._watched)]
            *_, copies, namespaces = self._client.calls([*unsubscribe, *self._lists()])
            self.copies, self.namespaces = _names(copies), _names(namespaces)
            self.copy(dict.fromkeys(sorted(self.copies)), ())
            self._list_namespaces(frozenset())


Submit = Callable[[Callable[[], None], Done | None], None]
"""Schedules a job on the thread that calls the parameter server; if that thread is too busy, the call's `Done` receives
an error."""


@dataclass(frozen=True, slots=True)
class ParameterContext:
    """The shared state of all nodes with shared parameters."""

    hub: Hub
    registry: Registry
    store: ParameterServer
    submit: Submit


SERVICES = {
    "get_parameters": "GetParameters",
    "get_parameter_types": "GetParameterTypes",
    "list_parameters": "ListParameters",
    "describe_parameters": "DescribeParameters",
    "set_parameters": "SetParameters",
    "set_parameters_atomically": "SetParametersAtomically",
}
"""The suffix of the service's name, and its type."""


def codecs(registry: Registry) -> dict[str, ServiceCodec]:
    """Return the codecs of the services, by the suffix of their names."""
    return {service: ServiceCodec(registry, f"rcl_interfaces/srv/{name}") for service, name in SERVICES.items()}
