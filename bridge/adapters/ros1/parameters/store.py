"""ROS 1's parameter server, through the master's API (wiki.ros.org/ROS/Parameter Server API)."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bridge.adapters.ros1_peers import Call, Ros1Error, XmlRpcClient
from bridge.hub.endpoints.calls import Done
from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from bridge.messages.values import ServiceCodec

_TIMEOUT = 2.0
_STOP_TIMEOUT = 0.5
_BATCH = 200


class ParameterServer:
    """A master's parameter server, for one thread; raises `Ros1Error`. ``slave`` is our node's XML-RPC address."""

    def __init__(self, uri: str, caller: Callable[[], str], slave: str) -> None:
        self._uri, self._caller, self._slave = uri, caller, slave
        self._client = XmlRpcClient(uri, _TIMEOUT)
        self._watched: set[str] = set()

    def watch(self, keys: Sequence[str]) -> dict[str, Any]:
        """Read parameters or namespaces, and subscribe to changes below them; {} for what is not set.

        A restarted master has forgotten who listens, so this asks for it each time.
        """
        self._watched |= set(keys)
        calls: list[Call] = [("subscribeParam", (self._caller(), self._slave, key)) for key in keys]
        values = self._client.calls(calls) if calls else []
        return dict(zip(keys, values, strict=True))

    def write(self, values: Mapping[str, Any]) -> list[str]:
        """Set parameters, and delete those whose value is None; those that the master did not set."""
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

    def close(self, written: Sequence[str]) -> None:
        """Delete what we wrote, and unsubscribe."""
        me = self._caller()
        calls: list[Call] = [("deleteParam", (me, key)) for key in written]
        calls += [("unsubscribeParam", (me, self._slave, key)) for key in sorted(self._watched)]
        self._client.close()
        client = XmlRpcClient(self._uri, _STOP_TIMEOUT)
        with contextlib.closing(client), contextlib.suppress(Ros1Error):
            if calls:
                client.calls(calls)


Submit = Callable[[Callable[[], None], Done | None], None]
"""Has something done on the one thread that talks to the parameter server; who waits is told where that is too busy."""


@dataclass(frozen=True, slots=True)
class ParameterContext:
    """What all nodes with shared parameters use."""

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
"""What follows the node's name, and the type."""


def codecs(registry: Registry) -> dict[str, ServiceCodec]:
    """The codecs of the services, by what follows the node's name."""
    return {word: ServiceCodec(registry, f"rcl_interfaces/srv/{name}") for word, name in SERVICES.items()}
