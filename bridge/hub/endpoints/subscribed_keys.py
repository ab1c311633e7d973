"""The additional keys of a subscription on zenoh, and the token that announces the subscription."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from bridge.hub.endpoints.context import EndpointContext
from bridge.hub.endpoints.variants import Convert, Variants
from bridge.hub.wire.buffers import BUFFER_TYPES, CPU_BACKEND, group_key
from bridge.hub.wire.keys import NO_HASH, key_type, key_variant
from bridge.messages.unchanged import same

End = Callable[[], None]
"""Ends a declaration on zenoh."""


class SubscribedKeys:
    """The keys of a subscription that follow the graph: those of other hashes, and the CPU group of each hash.

    Args:
        declare: subscribes to the key of another hash, given the conversion of its messages.
        declare_group: subscribes to the key of a CPU group, given the conversion of its messages.
    """

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        topic: str,
        declare: Callable[[str, Convert], End],
        declare_group: Callable[[str, Convert], End],
    ) -> None:
        self._context, self._token, self._key, self._topic = context, token, key, topic
        self._declare, self._declare_group = declare, declare_group
        self._type_name, self._type_hash = key_type(key)
        self._more: dict[str, End] = {}  # by key
        self._withdraw: End | None = None
        self._closed = False
        self._end_group = declare_group(group_key(key), same) if self._type_name in BUFFER_TYPES else None

    def announce(self) -> None:
        """Announce the subscription, as a member of the CPU group if it is one; replaces an earlier announcement."""
        if self._withdraw is not None:
            # withdraw the old token first, because releases before Lyrical do not distinguish the two tokens
            self._withdraw()
        token = self._token if self._end_group is None else f"{self._token}/{CPU_BACKEND}"
        self._withdraw = self._context.graph.announce(token)

    def follow_variants(self, variants: Variants) -> None:
        """Subscribe under the other hashes that publishers announce, and to the CPU groups if one has buffers."""
        if self._end_group is None and self._context.graph.has_buffers(self._topic, self._type_name):
            self._end_group = self._declare_group(group_key(self._key), same)
            if self._withdraw is not None:
                self.announce()
            if self._closed and self._withdraw is not None:
                self._withdraw()
                self._end_group()
        wanted = self._of_variants(variants)
        for key in wanted.keys() - self._more.keys():
            self._more[key] = wanted[key]()
        for key in self._more.keys() - (() if self._closed else wanted.keys()):
            self._end_more(key)

    def _of_variants(self, variants: Variants) -> dict[str, Callable[[], End]]:
        """Return functions that subscribe to the keys of other hashes, by key.

        A publisher with buffers has the CPU group of its own hash.
        """
        keys: dict[str, Callable[[], End]] = {}
        for type_hash in variants:
            convert = self._context.variants.converter(self._type_name, type_hash, self._type_hash)
            key = key_variant(self._key, type_hash)
            keys[key] = partial(self._declare, key, convert)
            if self._end_group is not None and type_hash != NO_HASH:  # releases without hashes have no buffers
                keys[group_key(key)] = partial(self._declare_group, group_key(key), convert)
        return keys

    def _end_more(self, key: str) -> None:
        end = self._more.pop(key, None)
        if end is not None:
            end()

    def close(self) -> None:
        self._closed = True
        self._context.variants.remove(self)
        if self._withdraw is not None:
            self._withdraw()
        if self._end_group is not None:
            self._end_group()
        for key in tuple(self._more):
            self._end_more(key)
