"""Parameters of a ROS 2 node, kept on ROS 1's parameter server, and set on the node where ROS 1 changes them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bridge.adapters.ros1.parameters.store import ParameterContext, codecs
from bridge.adapters.ros1.parameters.values import (
    NOT_SET,
    ParameterNames,
    ParameterType,
    ParameterValue,
    UnsayableError,
    flatten,
    to_ros1,
    to_ros2,
)
from bridge.config.sections.routing import ParameterRule
from bridge.hub.endpoints.calls import CallError
from bridge.messages.errors import ConversionError

_log = logging.getLogger(__name__)

_Values = dict[str, ParameterValue]
_USED = ("list_parameters", "get_parameters", "get_parameter_types", "set_parameters")


class MirroredNode:
    """One rule whose parameters a ROS 2 node owns. All but the constructor runs on the parameters' thread.

    Where both sides changed one since the last look, the node's value counts, and so it does when the node comes. A
    value that the node refuses is put back. ``wake`` has that thread look again, from any thread.
    """

    def __init__(self, rule: ParameterRule, context: ParameterContext, wake: Callable[[], None]) -> None:
        self.rule = rule
        self._names = ParameterNames(rule)
        self._hub, self._store, self._submit, self._wake = context.hub, context.store, context.submit, wake
        self._codecs = {word: codec for word, codec in codecs(context.registry).items() if word in _USED}
        self._clients: dict[str, Any] = {}
        self._busy = False
        self._agreed: dict[str, ParameterValue] = {}
        """By what follows the rule's name: the value that both had at the last look."""
        self.written: set[str] = set()
        """Names on the parameter server that we set."""
        self._careful = False
        self._unsaid: dict[str, str] = {}
        self._refused: dict[str, str] = {}

    @property
    def count(self) -> int:
        """How many parameters are shared."""
        return len(self._agreed)

    @property
    def troubles(self) -> dict[str, str]:
        """The trouble of each parameter."""
        return {**self._unsaid, **self._refused}

    @property
    def there(self) -> bool:
        """Whether the node is."""
        return bool(self._clients) and all(client.ready for client in self._clients.values())

    def follow(self) -> None:
        """Begin a look at the node, unless one is under way."""
        if not self._clients:
            for word, codec in self._codecs.items():
                name = f"{self.rule.node}/{word}"
                self._clients[word] = self._hub.client(name, codec.type.name, codec.type.type_id, self._wake)
        if not self.there:
            self._agreed = {}
        elif not self._busy:
            self._busy = True
            self._look()

    def _look(self) -> None:
        prefixes = [self.rule.prefix] if self.rule.prefix else []
        self._call("list_parameters", {"prefixes": prefixes, "depth": 0}, self._listed)

    def close(self) -> None:
        """Ask no more. Safe to call twice."""
        clients, self._clients = self._clients, {}
        for client in clients.values():
            client.close()
        self._agreed, self._busy = {}, False

    def _call(self, word: str, request: Mapping[str, Any], then: Callable[[dict[str, Any]], bool]) -> None:
        """Ask the node; ``then`` gets the reply on the parameters' thread, and says whether the look goes on."""
        client, codec = self._clients[word], self._codecs[word]

        def answered(result: bytes | CallError) -> None:
            self._submit(lambda: take(result), None)

        def take(result: bytes | CallError) -> None:
            if self._clients.get(word) is not client:
                return  # closed meanwhile
            self._busy = False
            if isinstance(result, CallError):
                self._unsaid = {self.rule.node: str(result)} if self.there else {}
                return
            try:
                self._busy = then(codec.response_value(result))
            except ConversionError as err:
                self._unsaid = {self.rule.node: str(err)}

        client.call(codec.request(request), answered)

    def _listed(self, reply: Mapping[str, Any]) -> bool:
        names = [name for name in reply["result"]["names"] if self._names.rest(name) is not None]
        if self._careful:
            self._call("get_parameter_types", {"names": names}, lambda types: self._ask(names, types["types"]))
        else:
            self._ask(names, [ParameterType.STRING] * len(names))
        return True

    def _ask(self, names: Sequence[str], types: Sequence[int]) -> bool:
        wanted = [name for name, kind in zip(names, types, strict=False) if kind != ParameterType.NOT_SET]
        self._call("get_parameters", {"names": wanted}, lambda got: self._got(wanted, got))
        return True

    def _got(self, names: Sequence[str], reply: Mapping[str, Any]) -> bool:
        """Compare what the node has with what ROS 1 has and with what both had."""
        values = [ParameterValue.read(value) for value in reply["values"]]
        if len(values) != len(names):
            # rclcpp tells of no parameter at all where one of them was declared and never set.
            self._careful = True
            return False
        rests = [self._names.rest(name) or "" for name in names]
        node = {rest: value for rest, value in zip(rests, values, strict=True) if value != NOT_SET}
        tree = self._store.watch([self.rule.ros1])[self.rule.ros1]
        ros1 = dict(flatten(tree))
        self._unsaid = {}
        gone = {rest for rest in self._agreed if rest not in node}
        writes: dict[str, Any] = {self._names.ros1(rest): None for rest in gone if rest in ros1}
        wishes: _Values = {}
        for rest, value in node.items():
            self._compare(rest, value, ros1, writes, wishes)
        for rest in gone:
            del self._agreed[rest]
        self._write(writes)
        if not wishes:
            return False
        parameters = [{"name": self._names.ros2(rest), "value": wish.message()} for rest, wish in wishes.items()]
        self._call("set_parameters", {"parameters": parameters}, lambda result: self._set(node, wishes, result))
        return True

    def _compare(
        self, rest: str, value: ParameterValue, ros1: Mapping[str, Any], writes: dict[str, Any], wishes: _Values
    ) -> None:
        """One parameter: write it on ROS 1's server, wish for ROS 1's value, or leave both as they are."""
        key = self._names.ros1(rest)
        try:
            wanted = to_ros1(value)
        except UnsayableError as err:
            self._unsaid[key] = str(err)
            return
        theirs: ParameterValue | None = None
        try:
            theirs = to_ros2(ros1[rest], value.kind) if rest in ros1 else None
        except UnsayableError as err:
            self._unsaid[key] = str(err)
        if theirs is not None and theirs != value and self._agreed.get(rest) == value and self.rule.write:
            wishes[rest] = theirs
            return
        if self._agreed.get(rest) != value:
            self._refused.pop(key, None)
        self._agreed[rest] = value
        if theirs != value:
            writes[key] = wanted

    def _set(self, node: _Values, wishes: _Values, reply: Mapping[str, Any]) -> bool:
        """The node's answer to ROS 1's values."""
        writes: dict[str, Any] = {}
        for (rest, wish), result in zip(wishes.items(), reply["results"], strict=False):
            key = self._names.ros1(rest)
            self._refused.pop(key, None)
            if result["successful"]:
                self._agreed[rest] = wish
                continue
            reason = result["reason"] or "it gives no reason"
            self._refused[key] = f"{self.rule.node} refused {wish.content!r}: {reason}"
            _log.warning("parameter %s is put back: %s", key, self._refused[key])
            writes[key] = to_ros1(node[rest])
        self._write(writes)
        return False

    def _write(self, writes: Mapping[str, Any]) -> None:
        self._store.write(writes)
        self.written |= {key for key, value in writes.items() if value is not None}
        self.written -= {key for key, value in writes.items() if value is None}
