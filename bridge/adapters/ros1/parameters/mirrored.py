"""Parameters of a ROS 2 node, copied to ROS 1's parameter server, and set on the node when ROS 1 changes them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from difflib import get_close_matches
from functools import partial
from typing import Any

from bridge.adapters.ros1.parameters.node_calls import NodeCalls, NodeNamesakes
from bridge.adapters.ros1.parameters.store import ParameterContext
from bridge.adapters.ros1.parameters.values import (
    MAX_DEPTH,
    NOT_SET,
    ParameterNames,
    ParameterType,
    ParameterValue,
    UnrepresentableError,
    flatten,
    to_ros1,
    to_ros2,
    why_not_ros1,
)
from bridge.config.sections.routing import ParameterRule

_log = logging.getLogger(__name__)

_Values = dict[str, ParameterValue]
_LOGGED = 5
"""Maximum number of unknown names in one log line."""

_READ_ONLY = "routing.parameters has write: false"


class MirroredNode:
    """One rule whose parameters a ROS 2 node owns. All but the constructor runs on the parameters' thread.

    If both sides have changed a value since the last comparison, the node's value wins, as it does when the node
    starts. A value that the node rejects is reset in ROS 1. ``wake`` schedules a comparison, and may be called from any
    thread. Unless noted, the attributes are keyed by the part of a parameter's name that follows the rule's name in
    ROS 1.

    A value that ROS 1 cannot represent has no copy: a value that ROS 1 sets there is deleted, or set on the node.

    Attributes:
        skipped: the node's parameters whose names have characters that ROS 1 does not allow, sorted.
    """

    def __init__(self, rule: ParameterRule, context: ParameterContext, wake: Callable[[], None]) -> None:
        self.rule = rule
        self._names = ParameterNames(rule)
        self._store = context.store
        self._calls = NodeCalls(rule, context, wake, self._on_failure)
        self._namesakes = NodeNamesakes(rule, context)
        self._ask_types = False
        self._declared: frozenset[str] = frozenset()
        self.skipped: list[str] = []
        self._unheld: frozenset[str] = frozenset()  # parameters whose values ROS 1 cannot represent
        self._agreed: _Values = {}  # the values that both sides had at the last comparison
        self._unknown: frozenset[str] = frozenset()
        self._problems: dict[str, str] = {}  # problems of the last comparison, by the name in ROS 1
        self._found: dict[str, str] = {}  # those of the comparison under way, which calls the master meanwhile
        self._rejected: dict[str, str] = {}  # why the node did not accept the last value, by the name in ROS 1

    @property
    def count(self) -> int:
        """Number of shared parameters."""
        return len(self._agreed.keys() - self._unheld)

    @property
    def troubles(self) -> dict[str, str]:
        """The problem of each parameter, by its name in ROS 1."""
        whole = self._calls.silence or self._namesakes.text
        return {**self._problems, **self._rejected, **({self.rule.ros1: whole} if whole else {})}

    @property
    def present(self) -> bool:
        """Whether all used services of the node are on the hub."""
        return self._calls.present

    def covers(self, key: str) -> bool:
        """Return whether a name on ROS 1's parameter server can be a copy that this rule made."""
        ros1 = self.rule.ros1
        inside = key == ros1 or key.startswith(f"{ros1}/")
        return inside and self._names.covers(key.removeprefix(ros1).removeprefix("/"))

    def follow(self) -> None:
        """Begin a comparison with the node, unless one is running."""
        self._calls.open()
        if not self.present:
            self._reset()
            return
        self._namesakes.check()
        self._calls.check_reply()
        if not self._calls.busy:
            prefixes = [self.rule.prefix] if self.rule.prefix else []
            self._calls.call("list_parameters", {"prefixes": prefixes, "depth": 0}, self._on_names)

    def close(self) -> None:
        """Close the clients. Safe to call twice."""
        self._calls.close()
        self._reset()

    def _reset(self) -> None:
        """Drop the state, the call and the problems of a node that has ended."""
        self._calls.reset()
        self._namesakes.reset()
        self._agreed, self._unknown = {}, frozenset()
        self._problems, self._rejected = {}, {}
        self.skipped, self._unheld = [], frozenset()

    def _on_failure(self, reason: str) -> None:
        self._problems = {self.rule.node: reason} if self.present else {}

    # -- one comparison ------------------------------------------------------------------------------------------------

    def _on_names(self, response: Mapping[str, Any]) -> None:
        names = [name for name in response["result"]["names"] if self._names.rest(name) is not None]
        self.skipped = sorted(filter(self._names.is_skipped, response["result"]["names"]))
        self._declared = frozenset(self._names.rest(name) or "" for name in names)
        if self._ask_types:
            request = {"names": names}
            self._calls.call("get_parameter_types", request, lambda found: self._ask_values(names, found["types"]))
        else:
            self._ask_values(names, [ParameterType.STRING] * len(names))

    def _ask_values(self, names: Sequence[str], types: Sequence[int]) -> None:
        wanted = [name for name, kind in zip(names, types, strict=False) if kind != ParameterType.NOT_SET]
        self._calls.call("get_parameters", {"names": wanted}, lambda response: self._on_values(wanted, response))

    def _on_values(self, names: Sequence[str], response: Mapping[str, Any]) -> None:
        """Compare the node's values with the values in ROS 1 and with the values of the last comparison."""
        values = [ParameterValue.read(value) for value in response["values"]]
        if len(values) != len(names):
            # rclcpp and rclpy return no values if any of the parameters was declared but never set.
            self._ask_types = True
            return
        paths = [self._names.rest(name) or "" for name in names]
        node = {path: value for path, value in zip(paths, values, strict=True) if value != NOT_SET}
        ros1 = dict(flatten(self._store.watch([self.rule.ros1])[self.rule.ros1]))
        self._found = {}
        held, unheld = self._representable(node)
        foreign = frozenset(key for key in self._store.copies if not self.covers(key))
        leaves = {self._names.ros1(path) for path in ros1}
        # Deletions come first: a name without a value may become the namespace of others.
        old = (self._store.copies - foreign - {self._names.ros1(path) for path in held}) & leaves
        writes: dict[str, Any] = dict.fromkeys(old)
        held = self._unobstructed(held, leaves, old)
        copies = {self._names.ros1(path) for path in held}
        shown, self._unheld = unheld | held, frozenset(unheld)
        self._agreed = {path: value for path, value in self._agreed.items() if path in shown}
        self._rejected = {key: reason for key, reason in self._rejected.items() if self._is_declared(key)}
        changes = self._compare(shown, ros1, writes)
        unset = self._unset(node, ros1, writes)
        self._report_unknown(ros1)
        self._problems = self._found
        for key in self._store.copy(writes, foreign | copies):
            self._problems[key] = "ROS 1's master rejects it"
        if unset:
            request = {"names": [self._names.ros2(path) for path in unset]}
            on_types = partial(self._on_types, shown, changes, unset)
            self._calls.call("describe_parameters", request, on_types)
        else:
            self._set(shown, changes)

    def _representable(self, node: _Values) -> tuple[_Values, _Values]:
        """Return the values that ROS 1 can represent, and those that it cannot represent but whose names it allows.

        In ROS 1, no name can be both a value and a namespace.
        """
        held, unheld = _Values(), _Values()
        for path, value in sorted(node.items()):  # a name comes before the names below it
            above = next((outer for outer in _outer(path) if outer in held), None)
            if above is not None:
                reason = (
                    f"{self._names.ros1(above)} has a value and ROS 1 does not allow names below it;"
                    " choose between them with 'names' in routing.parameters"
                )
            elif path.count("/") >= MAX_DEPTH:
                reason = f"its name has more than {MAX_DEPTH} parts"
            elif reason := why_not_ros1(value):
                unheld[path] = value
            else:
                held[path] = value
                continue
            self._found[self._names.ros1(path)] = self._not_copied(path, reason)
        return held, unheld

    def _not_copied(self, path: str, reason: str) -> str:
        return f"{self._on_node(path)} is not copied, since {reason}"

    def _on_node(self, path: str) -> str:
        """Return a parameter's name on the node, for messages that begin with its name in ROS 1."""
        return f"{self._names.ros2(path)} of {self.rule.node}"

    def _unobstructed(self, shown: _Values, leaves: Collection[str], old: Collection[str]) -> _Values:
        """Return the values that overwrite no other names in ROS 1, except those that replaced a copy.

        The names ``old`` are about to be deleted.
        """
        existing = {*leaves, *self._store.copies}
        new = {path: key for path in shown if (key := self._names.ros1(path)) not in existing}
        if not new:
            return shown
        taken = self._store.taken(old)
        obstacles = {path: reason for path, key in new.items() if (reason := taken.obstacle(key))}
        self._found |= {new[path]: self._not_copied(path, reason) for path, reason in obstacles.items()}
        return {path: value for path, value in shown.items() if path not in obstacles}

    def _compare(self, shown: _Values, ros1: Mapping[str, Any], writes: dict[str, Any]) -> _Values:
        """Add what ROS 1 should have instead to ``writes``; return ROS 1's changes, which the node should get."""
        changes: _Values = {}
        for path, value in shown.items():
            key, agreed = self._names.ros1(path), self._agreed.get(path)
            theirs = self._converted(path, ros1[path], value.kind) if path in ros1 else None
            if theirs is not None and theirs != value and agreed == value:
                if self.rule.write:
                    changes[path] = theirs
                    continue
                self._reject(key, f"{self._on_node(path)} does not get {theirs.content!r}: {_READ_ONLY}")
            elif agreed != value:
                self._rejected.pop(key, None)
            self._agreed[path] = value
            if path in self._unheld:
                if path in ros1 and key not in writes:
                    writes[key] = None
                    if key not in self._rejected:
                        _log.warning("parameter %s is deleted in ROS 1: %s", key, self._found[key])
            elif theirs != value:
                writes[key] = to_ros1(value)
        return changes

    def _converted(self, path: str, value: Any, kind: ParameterType) -> ParameterValue | None:
        """Convert a value of ROS 1 to the type of the node's parameter; None if that type has no such value."""
        try:
            return to_ros2(value, kind)
        except UnrepresentableError as err:
            self._reject(self._names.ros1(path), f"{self._on_node(path)} does not get the value set in ROS 1: {err}")
            return None

    def _unset(self, node: _Values, ros1: Mapping[str, Any], writes: dict[str, Any]) -> dict[str, Any]:
        """Return ROS 1's values of parameters that the node has declared but not set, or delete them by ``writes``."""
        unset = {path: self._names.ros1(path) for path in sorted(self._declared - node.keys()) if path in ros1}
        unset = {path: key for path, key in unset.items() if key not in writes}
        if self.rule.write:
            return {path: ros1[path] for path in unset}
        for path, key in unset.items():
            self._reject(key, f"{self._on_node(path)} has no value, and does not get ROS 1's: {_READ_ONLY}")
            writes[key] = None
        return {}

    def _report_unknown(self, ros1: Mapping[str, Any]) -> None:
        """Report names in ROS 1 that the node lacks; they are not deleted, since another program may have set them."""
        known = [self._names.ros2(path) for path in self._declared]
        unknown = {
            path for path in ros1 if path not in self._declared and self._names.covers(path) and self._names.ros2(path)
        } - {path for path in ros1 if self._names.ros1(path) in self._store.copies}
        for path in unknown:
            name, intended = self._names.ros2(path), self._names.intended(path)
            if name in self.skipped:
                reason = f"not on {self.rule.node}: only names of letters, digits and underscores are shared"
            else:
                similar = get_close_matches(name, known, n=1)
                hint = f" (similar: {similar[0]})" if similar else ""
                reason = f"{self.rule.node} has no parameter {name}{hint}"
                if intended is not None:
                    verb = "is" if intended in self._declared else "would be"
                    reason = f"the parameter {name} of {self.rule.node} {verb} {self._names.ros1(intended)} there"
                reason += "; delete it in ROS 1, or exclude it with 'names' in routing.parameters"
            self._found[self._names.ros1(path)] = f"set in ROS 1, but {reason}"
        new = sorted(self._names.ros1(path) for path in unknown - self._unknown)
        if new:
            more = f" and {len(new) - _LOGGED} more" if len(new) > _LOGGED else ""
            names = ", ".join(new[:_LOGGED])
            _log.warning("set in ROS 1, but not shared parameters of %s: %s%s", self.rule.node, names, more)
        self._unknown = frozenset(unknown)

    def _on_types(
        self, shown: _Values, changes: _Values, unset: Mapping[str, Any], response: Mapping[str, Any]
    ) -> None:
        """Convert ROS 1's values of unset parameters to the types that the node has declared."""
        writes: dict[str, Any] = {}
        for (path, value), descriptor in zip(unset.items(), response["descriptors"], strict=False):
            key = self._names.ros1(path)
            change = self._converted(path, value, _kind(descriptor["type"]))
            if change is None:
                writes[key] = None
            else:
                changes[path] = change
        self._store.write(writes)
        self._set(shown, changes)

    def _set(self, shown: _Values, changes: _Values) -> None:
        if not changes:
            return
        parameters = [{"name": self._names.ros2(path), "value": change.message()} for path, change in changes.items()]
        request = {"parameters": parameters}
        self._calls.call("set_parameters", request, lambda response: self._on_results(shown, changes, response))

    def _on_results(self, shown: _Values, changes: _Values, response: Mapping[str, Any]) -> None:
        """Reset values that the node rejected."""
        writes: dict[str, Any] = {}
        for (path, change), result in zip(changes.items(), response["results"], strict=False):
            key = self._names.ros1(path)
            if result["successful"]:
                self._rejected.pop(key, None)
                self._agreed[path] = change
                continue
            reason = result["reason"] or "no reason given"
            self._reject(key, f"{self.rule.node} rejected {change.content!r} for {self._names.ros2(path)}: {reason}")
            writes[key] = to_ros1(shown[path]) if path in shown.keys() - self._unheld else None
        self._store.write(writes)

    def _reject(self, key: str, reason: str) -> None:
        self._rejected[key] = reason
        _log.warning("parameter %s is reset in ROS 1: %s", key, reason)

    def _is_declared(self, key: str) -> bool:
        return key.removeprefix(self.rule.ros1).removeprefix("/") in self._declared


def _kind(number: int) -> ParameterType:
    try:
        return ParameterType(number)
    except ValueError:
        return ParameterType.NOT_SET


def _outer(path: str) -> Collection[str]:
    """Return the names above a name: "" and ``a`` for ``a/b``."""
    parts = path.split("/") if path else []
    return ["/".join(parts[:count]) for count in range(len(parts))]
