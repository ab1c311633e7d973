"""Parameters that ROS 1 owns, served on the hub as parameters of a ROS 2 node."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from bridge.adapters.ros1.parameters.store import ParameterContext, codecs
from bridge.adapters.ros1.parameters.values import (
    NOT_SET,
    ParameterNames,
    ParameterType,
    ParameterValue,
    UnrepresentableError,
    flatten,
    to_ros1,
    to_ros2,
)
from bridge.adapters.ros1_peers import Ros1Error
from bridge.config.sections.routing import ParameterRule
from bridge.hub.endpoints.calls import Abandon, CallError, Done
from bridge.hub.graph.tokens import NodeToken, node_key
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import ConversionError
from bridge.messages.values import MessageWriter

EVENTS = "/parameter_events"
_EVENT = "rcl_interfaces/msg/ParameterEvent"
_EVENT_QOS = Qos(depth=1000)  # rmw_qos_profile_parameter_events


class OfferedNode:
    """A node on the hub with the parameters of ``rules``; ``token`` is the number of its token within the session.

    All but the constructor and `call` run on the parameters' thread.
    """

    def __init__(self, rules: Sequence[ParameterRule], context: ParameterContext, token: int) -> None:
        self.rules = rules
        self.node = rules[0].node
        # the rule with the longest prefix has precedence
        self._names = [ParameterNames(rule) for rule in sorted(rules, key=lambda rule: -len(rule.prefix))]
        self._hub, self._store, self._submit = context.hub, context.store, context.submit
        self._codecs = codecs(context.registry)
        self._event, self._event_schema = context.registry.ros2(_EVENT), context.registry.schema(_EVENT)
        namespace, _, name = self.node.rpartition("/")
        self._token = node_key(NodeToken(self._hub.domain, self._hub.zid, str(token), namespace or "/", name))
        self._closers: list[Callable[[], object]] = []
        self._publish: Callable[[bytes], None] | None = None
        self._published: dict[str, ParameterValue] | None = None
        self.troubles: dict[str, str] = {}

    @property
    def count(self) -> int:
        """Number of the node's parameters."""
        return len(self._published or ())

    def follow(self, trees: Mapping[str, Any]) -> None:
        """Serve the node, and publish changes; ``trees`` has ROS 1's values below each rule's name."""
        if not self._closers:
            self._open()
        now = dict(self._parameters(trees))
        before, self._published = self._published, now
        if before is not None and before != now:
            self._publish_event(before, now)

    def close(self) -> None:
        """Leave the hub. Safe to call twice."""
        closers, self._closers = self._closers, []
        for closer in closers:
            closer()
        self._published = self._publish = None
        self.troubles = {}

    def _open(self) -> None:
        self._closers.append(self._hub.graph.announce(self._token))
        for service, codec in self._codecs.items():
            kind = codec.type
            server = self._hub.server(f"{self.node}/{service}", kind.name, kind.type_id, partial(self.call, service))
            self._closers.append(server.close)
        publisher = self._hub.publisher(EVENTS, self._event.name, self._event.type_id, _EVENT_QOS)
        self._publish = publisher.put
        self._closers.append(publisher.close)

    def _parameters(self, trees: Mapping[str, Any]) -> Iterator[tuple[str, ParameterValue]]:
        """Yield each parameter with its name on the node; record the parameters that ROS 2 cannot represent."""
        self.troubles = {}
        for names in reversed(self._names):
            for path, value in flatten(trees.get(names.rule.ros1, {})):
                if names.covers(path) and names.ros2(path):
                    if intended := names.intended(path):
                        self.troubles[names.ros1(path)] = (
                            f"not on {self.node}, where {names.ros2(path)} is {names.ros1(intended)} of ROS 1"
                        )
                        continue
                    try:
                        yield names.ros2(path), to_ros2(value)
                    except UnrepresentableError as err:
                        self.troubles[names.ros1(path)] = f"not on {self.node} as {names.ros2(path)}: {err}"

    def _read(self) -> dict[str, ParameterValue]:
        return dict(self._parameters(self._store.watch([rule.ros1 for rule in self.rules])))

    def _publish_event(self, before: Mapping[str, ParameterValue], now: Mapping[str, ParameterValue]) -> None:
        message = {
            "stamp": dict(zip(("sec", "nanosec"), divmod(time.time_ns(), 10**9), strict=True)),
            "node": self.node,
            "new_parameters": [_parameter(name, now[name]) for name in now.keys() - before.keys()],
            "changed_parameters": [_parameter(n, v) for n, v in now.items() if n in before and before[n] != v],
            "deleted_parameters": [_parameter(name, NOT_SET) for name in before.keys() - now.keys()],
        }
        if self._publish is not None:
            self._publish(MessageWriter(self._event_schema).message(message))

    def call(self, service: str, request: bytes, done: Done) -> Abandon:
        """Schedule a call; called on zenoh's receiving thread."""
        self._submit(lambda: done(self._answer(service, request)), done)
        return lambda: None

    def _answer(self, service: str, request: bytes) -> bytes | CallError:
        codec = self._codecs[service]
        try:
            reply = getattr(self, f"_{service}")(codec.request_value(request))
        except Ros1Error as err:
            return CallError(f"ROS 1's parameter server does not respond: {err}")
        except ConversionError as err:
            return CallError(str(err))
        return codec.response(reply)

    def _get_parameters(self, request: Mapping[str, Any]) -> dict[str, Any]:
        known = self._read()
        return {"values": [known.get(name, NOT_SET).message() for name in request["names"]]}

    def _get_parameter_types(self, request: Mapping[str, Any]) -> dict[str, Any]:
        known = self._read()
        return {"types": [int(known.get(name, NOT_SET).kind) for name in request["names"]]}

    def _describe_parameters(self, request: Mapping[str, Any]) -> dict[str, Any]:
        known = self._read()
        return {"descriptors": [self._descriptor(name, known.get(name, NOT_SET)) for name in request["names"]]}

    def _descriptor(self, name: str, value: ParameterValue) -> dict[str, Any]:
        found = self._rule_for(name)
        where = "" if found is None else f"ROS 1 parameter {found[0].ros1(found[1])}"
        read_only = found is not None and not found[0].rule.write
        return {
            "name": name, "type": int(value.kind), "description": where, "read_only": read_only, "dynamic_typing": True,
        }  # fmt: skip

    def _list_parameters(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """List names like rclcpp's node_parameters.cpp; the depth counts dots after a prefix, and 0 means any depth."""
        prefixes, depth = request["prefixes"], request["depth"]

        def wanted(name: str) -> bool:
            suffixes = [name] if not prefixes else [
                name[len(prefix) + 1 :] for prefix in prefixes if name == prefix or name.startswith(f"{prefix}.")
            ]  # fmt: skip
            return any(depth == 0 or suffix.count(".") < depth for suffix in suffixes)

        names = sorted(name for name in self._read() if wanted(name))
        above = sorted({name.rpartition(".")[0] for name in names if "." in name})
        return {"result": {"names": names, "prefixes": above}}

    def _set_parameters(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return {"results": [self._set([parameter]) for parameter in request["parameters"]]}

    def _set_parameters_atomically(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return {"result": self._set(request["parameters"])}

    def _set(self, parameters: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Set all parameters or none."""
        taken = self._store.taken()
        wanted: dict[str, Any] = {}
        for parameter in parameters:
            name, value = parameter["name"], ParameterValue.read(parameter["value"])
            found = self._rule_for(name)
            if found is None:
                return _error(f"no rule of routing.parameters shares {name}")
            names, path = found
            if not names.rule.write:
                return _error(f"{name} is read-only (write: false in routing.parameters)")
            key = names.ros1(path)
            if obstacle := taken.obstacle(key):
                return _error(obstacle)
            taken.add(key)
            try:
                wanted[key] = None if value.kind is ParameterType.NOT_SET else to_ros1(value)
            except UnrepresentableError as err:
                return _error(f"{name}: {err}")
        refused = self._store.write(wanted)
        return _error(f"ROS 1's master rejects {', '.join(refused)}") if refused else {"successful": True, "reason": ""}

    def _rule_for(self, name: str) -> tuple[ParameterNames, str] | None:
        """Return the rule that shares a name, and the path after the rule's prefix; None if no rule shares it."""
        for names in self._names:
            path = names.rest(name)
            if path is not None:
                return names, path
        return None


def _parameter(name: str, value: ParameterValue) -> dict[str, Any]:
    return {"name": name, "value": value.message()}


def _error(reason: str) -> dict[str, Any]:
    return {"successful": False, "reason": reason}
