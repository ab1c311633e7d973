"""Decides whether Midspan created an endpoint, by its participant's GUID prefix, enclave or presence topic.

Midspan's participant on Fast DDS has a marked GUID prefix (`bridge.adapters.ros2.graph.origins`). Cyclone DDS chooses
GUIDs itself, so Midspan's participant on Cyclone DDS has only a marked enclave, which rmw announces with each
participant. Cyclone DDS reports the enclave before any endpoint of the participant. rmw_fastrtps reports it by node
only, so on Fast DDS the origin of an endpoint on Cyclone DDS is unknown until its participant has announced its nodes.
Midspan's participants on Fast DDS have the enclave, too, so that they may have nodes with the same names as Midspan's
participants on Cyclone DDS.

A secured domain has neither mark: DDS Security derives the whole prefix from the certificate and a hash, and the
enclave is one of the keystore. There a participant is Midspan's if it has a writer of the presence topic.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping

from typing_extensions import override

from bridge.adapters.ros2.graph import vendors
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES, is_marked
from bridge.routing.edge import MadeBy

ENCLAVE = "/_midspan/origin"
"""The marked enclave. Every Midspan daemon takes a node with it for Midspan's, so no other program may use it."""

PRESENCE = "/_midspan/presence"
"""The topic of `bridge.adapters.ros2.graph.presence`."""

_MAX_KNOWN = 2000


class Marks(ABC):
    """Who created the participants on the network, as far as that is known; thread-safe."""

    @abstractmethod
    def made_by(self, gid: bytes) -> MadeBy:
        """Return who created an endpoint or a participant, by its GUID or GUID prefix."""

    def refresh(self) -> None:  # noqa: B027 - marks that never change need none
        """Read again what may have changed; called before each read of the graph."""

    @abstractmethod
    def of_endpoint(self, gid: bytes, node: str, *, has_hash: bool) -> MadeBy:
        """Return who created an endpoint of a node ("" if it is not known); ``has_hash``: it announces a type hash."""


class NodeMarks(Marks):
    """The marks on Fast DDS. ``enclaves`` returns the enclaves of all nodes, by the nodes' full names."""

    def __init__(self, enclaves: Callable[[], Mapping[str, Collection[str]]]) -> None:
        self._enclaves = enclaves
        self._lock = threading.Lock()
        self._known: dict[bytes, MadeBy] = {}

    @override
    def made_by(self, gid: bytes) -> MadeBy:
        if is_marked(gid):
            return MadeBy.MIDSPAN
        if not vendors.is_cyclone(gid):
            return MadeBy.NATIVE
        return self._known.get(gid[:PREFIX_BYTES], MadeBy.UNKNOWN)

    @override
    def of_endpoint(self, gid: bytes, node: str, *, has_hash: bool) -> MadeBy:
        """Return who created an endpoint; endpoints without a hash are of plain DDS programs or of Humble."""
        made_by = self.made_by(gid)
        if made_by is not MadeBy.UNKNOWN:
            return made_by
        if not has_hash:
            return MadeBy.NATIVE
        enclaves = self._enclaves().get(node, ()) if node else ()
        if not enclaves or (ENCLAVE in enclaves and len(enclaves) > 1):  # or two nodes with one name
            return MadeBy.UNKNOWN
        made_by = MadeBy.MIDSPAN if ENCLAVE in enclaves else MadeBy.NATIVE
        with self._lock:
            while len(self._known) >= _MAX_KNOWN:
                del self._known[next(iter(self._known))]
            self._known[gid[:PREFIX_BYTES]] = made_by
        return made_by


class EnclaveMarks(Marks):
    """The marks on Cyclone DDS. ``enclave`` returns the enclave of a GUID prefix, "" for none, None if unknown yet."""

    def __init__(self, enclave: Callable[[bytes], str | None]) -> None:
        self._enclave = enclave

    @override
    def made_by(self, gid: bytes) -> MadeBy:
        if is_marked(gid):
            return MadeBy.MIDSPAN
        enclave = self._enclave(gid[:PREFIX_BYTES])
        if enclave is None:
            return MadeBy.UNKNOWN
        return MadeBy.MIDSPAN if enclave == ENCLAVE else MadeBy.NATIVE

    @override
    def of_endpoint(self, gid: bytes, node: str, *, has_hash: bool) -> MadeBy:
        return self.made_by(gid)


class PresenceMarks(Marks):
    """The marks in a secured domain. ``announced`` returns the GUIDs of all discovered writers of the presence topic.

    This writer is a participant's first, and a participant announces its writers in their order, so it is discovered
    before any bridged endpoint.
    """

    def __init__(self, announced: Callable[[], Collection[bytes]]) -> None:
        self._announced = announced
        self._lock = threading.Lock()
        self._known: dict[bytes, MadeBy] = {}

    @override
    def made_by(self, gid: bytes) -> MadeBy:
        prefix = gid[:PREFIX_BYTES]
        known = self._known.get(prefix)
        if known is None:
            midspans = self._midspans()
            known = MadeBy.MIDSPAN if prefix in midspans else MadeBy.NATIVE
            with self._lock:
                while len(self._known) >= _MAX_KNOWN:
                    del self._known[next(iter(self._known))]
                self._known[prefix] = known
        return known

    @override
    def refresh(self) -> None:
        midspans = dict.fromkeys(self._midspans(), MadeBy.MIDSPAN)
        with self._lock:
            self._known.update(midspans)

    @override
    def of_endpoint(self, gid: bytes, node: str, *, has_hash: bool) -> MadeBy:
        return self.made_by(gid)

    def _midspans(self) -> set[bytes]:
        return {gid[:PREFIX_BYTES] for gid in self._announced()}
