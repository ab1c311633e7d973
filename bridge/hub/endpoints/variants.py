"""Key variants: additional keys of an endpoint, one for each other type hash that peers on the same topic announce.

A key ends with the hash of its type (`bridge.hub.wire.keys`), which differs between releases of ROS 2. An endpoint uses
the key with its own hash, and the keys with the other hashes of its counterparts: subscriptions for a publisher,
publishers for a subscription, servers for a client. It converts the messages on the other keys (`TypeVersions`); those
of `NO_HASH` (Humble) usually need no conversion. A publisher or subscription uses a variant while the graph has a
counterpart with that hash. Subscriptions also use the key of the CPU group (`bridge.hub.wire.buffers`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from threading import Lock
from typing import Protocol

import zenoh
from typing_extensions import override

from bridge.concurrency import SerialExecutor
from bridge.hub.graph import HubGraph
from bridge.hub.graph.hashes import KindOfEndpoint
from bridge.hub.graph.tokens import UNKNOWN_HASH, EndpointKind, EndpointToken, parse_token
from bridge.hub.wire.keys import NO_HASH, has_key
from bridge.messages.unchanged import same

Convert = Callable[[bytes], bytes]
"""Converts a message to another version of its type; raises `bridge.messages.errors.ConversionError`."""

Variants = Mapping[str, bool]
"""The other hashes that an endpoint's counterparts announce, each with whether such a counterpart is latched."""

CONVERTED = zenoh.Encoding("application/cdr;converted")
"""Encoding of a sample that a publisher converted from its own version of the type; other samples have none."""

RELAYED = zenoh.Encoding("application/cdr;relayed")
"""Encoding of a sample that Midspan's relay (`bridge.routing.relay`) published under a hash other than its publisher's.
Midspan's subscriptions ignore it, because they receive the original."""

REQUEST, RESPONSE = "Request", "Response"

_log = logging.getLogger(__name__)
_COUNTERPARTS = {
    EndpointKind.PUBLISHER: EndpointKind.SUBSCRIPTION,
    EndpointKind.SUBSCRIPTION: EndpointKind.PUBLISHER,
    EndpointKind.CLIENT: EndpointKind.SERVER,
}


class TypeVersions(Protocol):
    """The versions of types, as in `bridge.messages.mapping.releases.ReleaseConversions`."""

    def hashes(self, type_name: str) -> Collection[str]:
        """Return the hashes of all known versions of a type."""

    def here(self, type_name: str, type_hash: str) -> str:
        """Return the installed version's hash if the version ``type_hash`` can be converted, else ``type_hash``."""

    def converter(self, type_name: str, source: str, target: str, part: str = "") -> Convert | None:
        """Return the converter between two versions of a type, or of a service's part; None if a version is unknown."""

    def losses(
        self, type_name: str, source: str, target: str, part: str = ""
    ) -> tuple[Collection[str], Collection[str]]:
        """Return the fields that are left out between two versions, and those that may be rounded or refused."""

    def release(self, type_name: str, type_hash: str) -> str:
        """Return the first release or folder that contains a version, "" if none does."""


class OneVersion(TypeVersions):
    """The versions for a node without definitions, which assumes that peers without a hash have the same version."""

    @override
    def hashes(self, type_name: str) -> Collection[str]:
        return ()

    @override
    def here(self, type_name: str, type_hash: str) -> str:
        return type_hash

    @override
    def converter(self, type_name: str, source: str, target: str, part: str = "") -> Convert | None:
        return same if NO_HASH in (source, target) else None

    @override
    def losses(
        self, type_name: str, source: str, target: str, part: str = ""
    ) -> tuple[Collection[str], Collection[str]]:
        return (), ()

    @override
    def release(self, type_name: str, type_hash: str) -> str:
        return ""


class VariedEndpoint(Protocol):
    """An endpoint with key variants."""

    def follow_variants(self, variants: Variants) -> None:
        """Add and remove keys; called by one thread at a time, possibly after the endpoint was closed. May block."""


@dataclass(frozen=True, slots=True)
class _Followed:
    """An endpoint's ``counterpart``, None if it needs no variants, and the lock that serializes the updates."""

    topic: str
    type_hash: str
    counterpart: KindOfEndpoint | None
    exact: bool
    updating: Lock = field(default_factory=Lock)


class KeyVariants:
    """Updates the key variants of one node's endpoints when the graph changes. Safe to use from any thread.

    The updates run on the executor, because zenoh's thread, which reports the tokens, must not block. No common lock is
    held meanwhile, because an update may wait for a congested link, and new endpoints must not wait for the update.

    Attributes:
        versions: the known versions of types, set before the endpoints exist.
    """

    def __init__(self, graph: HubGraph, executor: SerialExecutor) -> None:
        self.versions: TypeVersions = OneVersion()
        self._graph, self._executor = graph, executor
        self._endpoints: dict[VariedEndpoint, _Followed] = {}
        self._lock = Lock()
        self._version = 0
        self.close: Callable[[], None] = graph.watch(self._graph_changed)

    def add(self, endpoint: VariedEndpoint, token: str, *, exact: bool = False) -> None:
        """Add an endpoint's key variants, and follow the graph; call this before the endpoint's token is announced.

        An ``exact`` endpoint has only the variant of `NO_HASH`.
        """
        about = parse_token(token)
        assert isinstance(about, EndpointToken)
        covered = about.type_hash in (NO_HASH, UNKNOWN_HASH)  # with UNKNOWN_HASH, the key covers all hashes
        counterpart = None if covered else (_COUNTERPARTS[about.kind], about.topic, about.type_name)
        followed = _Followed(about.topic, about.type_hash, counterpart, exact)
        with self._lock:
            self._endpoints[endpoint] = followed
        self._update(endpoint, followed)

    def remove(self, endpoint: VariedEndpoint) -> None:
        """Stop updating an endpoint, without waiting for an update in progress."""
        with self._lock:
            self._endpoints.pop(endpoint, None)

    def converter(self, type_name: str, source: str, target: str, part: str = "") -> Convert:
        """Return the converter between the two versions of a variant, `same` if none is known."""
        return self.versions.converter(type_name, source, target, part) or same

    def _graph_changed(self) -> None:
        version = self._graph.variants_version
        if version != self._version:
            self._version = version
            self._executor.submit(self._follow)

    def _follow(self) -> None:
        with self._lock:
            endpoints = tuple(self._endpoints.items())
        for endpoint, followed in endpoints:
            try:
                self._update(endpoint, followed)
            except Exception as err:  # the next change of the graph repeats the update
                _log.warning("%s: cannot update the keys for other releases: %s", followed.topic, err)

    def _update(self, endpoint: VariedEndpoint, followed: _Followed) -> None:
        with followed.updating:
            counterpart = followed.counterpart
            if counterpart is None:
                endpoint.follow_variants({})
                return
            type_name, own = counterpart[2], followed.type_hash
            hashes = self._graph.other_hashes(counterpart)
            endpoint.follow_variants({
                other: latched
                for other, latched in hashes.items()
                if other != own
                and has_key(other)
                and (other == NO_HASH or not followed.exact)
                and self.versions.converter(type_name, own, other, self._part(counterpart)) is not None
            })  # fmt: skip

    @staticmethod
    def _part(counterpart: KindOfEndpoint) -> str:
        return REQUEST if counterpart[0] is EndpointKind.SERVER else ""


class ConvertedSample:
    """A sample of another version of its type, with the converted payload; raises `ConversionError`."""

    __slots__ = ("attachment", "encoding", "key_expr", "kind", "payload", "source_info")

    def __init__(self, sample: zenoh.Sample, convert: Convert) -> None:
        self.attachment, self.kind, self.source_info = sample.attachment, sample.kind, sample.source_info
        self.key_expr, self.encoding, payload = sample.key_expr, sample.encoding, sample.payload
        # an empty sample, from a cache that was cleared, stays empty
        self.payload = zenoh.ZBytes(convert(payload.to_bytes())) if len(payload) else payload
