"""The additional keys of a subscription on zenoh, and the token that announces the subscription."""

from __future__ import annotations

from collections.abc import Callable

from bridge.hub.endpoints.publisher import EndpointContext
from bridge.hub.endpoints.variants import Convert, Variants
from bridge.hub.wire.buffers import BUFFER_TYPES, CPU_BACKEND, group_key
from bridge.hub.wire.keys import key_type, key_variant

End = Callable[[], None]
"""Ends a declaration on zenoh."""


class SubscribedKeys:
    """The keys of a subscription that follow the graph: those of other hashes, and the topic's CPU group.

    Args:
        declare: subscribes to the key of another hash, given the conversion of its messages.
        declare_group: subscribes to the key of the CPU group.
    """

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        topic: str,
        declare: Callable[[str, Convert], End],
        declare_group: Callable[[str], End],
    ) -> None:
        self._context, self._token, self._key, self._topic = context, token, key, topic
        self._declare, self._declare_group = declare, declare_group
        self._type_name, self._type_hash = key_type(key)
        self._more: dict[str, End] = {}  # by type hash
        self._withdraw: End | None = None
        self._closed = False
        self._end_group = declare_group(group_key(key)) if self._type_name in BUFFER_TYPES else None

    def announce(self) -> None:
        """Announce the subscription, as a member of the CPU group if it is one; replaces an earlier announcement."""
        if self._withdraw is not None:
            # withdraw the old token first, because releases before Lyrical do not distinguish the two tokens
            self._withdraw()
        token = self._token if self._end_group is None else f"{self._token}/{CPU_BACKEND}"
        self._withdraw = self._context.graph.announce(token)

    def follow_variants(self, variants: Variants) -> None:
        """Subscribe under the other hashes that publishers announce, and to the CPU group if one has buffers."""
        if self._end_group is None and self._context.graph.has_buffers(self._topic, self._type_name):
            self._end_group = self._declare_group(group_key(self._key))
            if self._withdraw is not None:
                self.announce()
            if self._closed and self._withdraw is not None:
                self._withdraw()
                self._end_group()
        for type_hash in variants.keys() - self._more.keys():
            convert = self._context.variants.converter(self._type_name, type_hash, self._type_hash)
            self._more[type_hash] = self._declare(key_variant(self._key, type_hash), convert)
        for type_hash in self._more.keys() - (() if self._closed else variants.keys()):
            self._end_more(type_hash)

    def _end_more(self, type_hash: str) -> None:
        end = self._more.pop(type_hash, None)
        if end is not None:
            end()

    def close(self) -> None:
        self._closed = True
        self._context.variants.remove(self)
        if self._withdraw is not None:
            self._withdraw()
        if self._end_group is not None:
            self._end_group()
        for type_hash in tuple(self._more):
            self._end_more(type_hash)
