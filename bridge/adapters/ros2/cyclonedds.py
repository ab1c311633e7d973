"""The worker's own participant on Cyclone DDS (``ros2.rmw``): its settings, and what rmw_cyclonedds_cpp does not offer.

rmw_cyclonedds_cpp identifies the publisher of a message by a number of this process only, and does not report the
enclave of a participant. Readers of Cyclone DDS's built-in topics have both, here through its C API (``dds.h``, the
same in 0.10 and 11.0).
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from ctypes import (
    CDLL,
    POINTER,
    Structure,
    byref,
    c_bool,
    c_int32,
    c_int64,
    c_size_t,
    c_ubyte,
    c_uint32,
    c_uint64,
    c_void_p,
    string_at,
)
from typing import Any
from xml.etree import ElementTree as ET

from bridge.adapters.ros2.environment import LIBRARY, SWITCHES, UNSET
from bridge.adapters.ros2.graph.interfaces import ipv4_addresses
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.graph.spdp import PARTICIPANTS
from bridge.config.model import Config
from bridge.messages.errors import MessageTypeError

URI = "CYCLONEDDS_URI"
_LOOPBACK = "127.0.0.1"
_PORTS = 2 * PARTICIPANTS
"""Number of this machine's participants addressed by unicast; Midspan's on Fast DDS have numbers from 32 on."""

_ANNOUNCEMENT, _LEASE = "500ms", "20s"
"""As on Fast DDS (`bridge.adapters.ros2.profile`), so that Midspan daemons discover each other equally fast on both."""


def settings(*, localhost_only: bool, interfaces: Iterable[str], peers: Iterable[str] = ()) -> str:
    """Return the XML settings of the participant.

    With ``localhost_only`` it announces itself on loopback only, but has an address on each interface, because programs
    with Cyclone DDS's own default settings have none on loopback.

    Args:
        localhost_only: discover nodes of this machine only.
        interfaces: names of the interfaces to use in addition to loopback; if empty, Cyclone DDS chooses an interface.
        peers: addresses of machines to announce itself to.
    """
    domain = ET.Element("Domain", Id="any")
    discovery = ET.SubElement(domain, "Discovery")
    for name, value in (
        ("ParticipantIndex", "auto"), ("MaxAutoParticipantIndex", str(_PORTS - 1)), ("SPDPInterval", _ANNOUNCEMENT),
        ("LeaseDuration", _LEASE),
    ):  # fmt: skip
        ET.SubElement(discovery, name).text = value
    listed = ET.SubElement(discovery, "Peers")
    for address in (_LOOPBACK, *peers):
        ET.SubElement(listed, "Peer", Address=address)
    names = list(interfaces)
    if names or localhost_only:
        used = ET.SubElement(ET.SubElement(domain, "General"), "Interfaces")
        ET.SubElement(used, "NetworkInterface", address=_LOOPBACK, multicast="true")
        for name in names:
            ET.SubElement(used, "NetworkInterface", name=name, multicast="false" if localhost_only else "default")
    root = ET.Element("CycloneDDS")
    root.append(domain)
    return ET.tostring(root, encoding="unicode")


def use_settings(config: Config, peers: Iterable[str]) -> None:
    """Set this process's environment for its participant.

    Cyclone DDS reads a user's ``CYCLONEDDS_URI`` after Midspan's settings; with ``localhost_only`` the user's variable
    is ignored, because it could undo that restriction.
    """
    local = config.ros2.localhost_only
    own = "" if local else os.environ.get(URI, "")
    names = [] if own else sorted({name for name, _ in ipv4_addresses()})
    xml = settings(localhost_only=local, interfaces=names, peers=peers)
    for name in UNSET:
        os.environ.pop(name, None)
    os.environ.update(SWITCHES[config.ros2.rmw] | {URI: ",".join(filter(None, (xml, own)))})


# -- built-in topics ---------------------------------------------------------------------------------------------------

_PARTICIPANTS, _WRITERS, _READERS = 0x7FFF0001, 0x7FFF0003, 0x7FFF0004
"""``DDS_BUILTIN_TOPIC_DCPSPARTICIPANT``, ``..._DCPSPUBLICATION`` and ``..._DCPSSUBSCRIPTION``."""
_ALIVE = 16
"""``DDS_ALIVE_INSTANCE_STATE``."""
_BATCH = 64
_DEPARTED = 1000
"""Number of departed participants, writers or readers to remember, because their last messages may still be unread."""
_GUID_BYTES = 16
_MATCHED = 64
"""Room for the readers that a writer has matched; it grows as needed."""


class _Info(Structure):
    """``dds_sample_info_t``."""

    _fields_ = [
        ("sample_state", c_int32), ("view_state", c_int32), ("instance_state", c_int32), ("valid", c_bool),
        ("source_timestamp", c_int64), ("instance", c_uint64), ("publication", c_uint64), ("ranks", c_uint32 * 5),
    ]  # fmt: skip


class _Participant(Structure):
    """``dds_builtintopic_participant_t``."""

    _fields_ = [("guid", c_ubyte * _GUID_BYTES), ("qos", c_void_p)]


def _library() -> CDLL:
    """Return rmw_cyclonedds_cpp, which resolves the functions of Cyclone DDS, too."""
    library = CDLL(LIBRARY)
    signatures: dict[str, list[Any]] = {
        "dds_lookup_participant": [c_uint32, POINTER(c_int32), c_size_t],
        "dds_get_guid": [c_int32, c_void_p],
        "dds_get_instance_handle": [c_int32, POINTER(c_uint64)],
        "dds_create_reader": [c_int32, c_int32, c_void_p, c_void_p],
        "dds_take": [c_int32, POINTER(c_void_p), POINTER(_Info), c_size_t, c_uint32],
        "dds_return_loan": [c_int32, POINTER(c_void_p), c_int32],
        "dds_get_matched_subscriptions": [c_int32, POINTER(c_uint64), c_size_t],
        "dds_qget_userdata": [c_void_p, POINTER(c_void_p), POINTER(c_size_t)],
        "dds_free": [c_void_p],
    }
    for name, arguments in signatures.items():
        function = getattr(library, name)
        function.argtypes, function.restype = arguments, c_int32
    library.dds_qget_userdata.restype, library.dds_free.restype = c_bool, None
    return library


class _Endpoints:
    """The GUIDs of all writers, or of all readers, by instance handle; ``reader`` is the built-in topic's reader."""

    def __init__(self, reader: int) -> None:
        self.reader = reader
        self.guids: dict[int, bytes] = {}
        self._departed: deque[int] = deque()

    def add(self, handle: int, guid: bytes, *, alive: bool) -> None:
        self.guids[handle] = guid
        if not alive:
            self._departed.append(handle)
        while len(self._departed) > _DEPARTED:
            self.guids.pop(self._departed.popleft(), None)


class Discovery:
    """The participants and endpoints that this process's participant has discovered; thread-safe.

    Raises `RuntimeError` if the process has no participant on the domain, or several.

    Attributes:
        prefix: the participant's own GUID prefix.
    """

    def __init__(self, domain: int) -> None:
        self._dds = _library()
        participants = (c_int32 * 2)()
        count = self._dds.dds_lookup_participant(domain, participants, len(participants))
        if count != 1:
            raise RuntimeError(f"{count} participants of Cyclone DDS on domain {domain} in this process, instead of 1")
        guid = (c_ubyte * _GUID_BYTES)()
        self._check("dds_get_guid", self._dds.dds_get_guid(participants[0], guid))
        self.prefix = bytes(guid)[:PREFIX_BYTES]
        self._lock = threading.Lock()
        self._participants = self._reader(participants[0], _PARTICIPANTS)
        self._writers, self._readers = (
            _Endpoints(self._reader(participants[0], _WRITERS)),
            _Endpoints(self._reader(participants[0], _READERS)),
        )
        self._buffers, self._infos = (c_void_p * _BATCH)(), (_Info * _BATCH)()
        self._enclaves: dict[bytes, str] = {}
        self._departed: deque[bytes] = deque()

    def _reader(self, participant: int, topic: int) -> int:
        return self._check("dds_create_reader", self._dds.dds_create_reader(participant, topic, None, None))

    @staticmethod
    def _check(call: str, result: int) -> int:
        if result < 0:
            raise RuntimeError(f"{call} failed with code {result} (Cyclone DDS, dds.h)")
        return result

    def enclave(self, prefix: bytes) -> str | None:
        """Return the enclave of a participant by its GUID prefix; "" if it has none, None before it is discovered."""
        known = self._enclaves.get(prefix)
        if known is None:
            with self._lock:
                self._read_participants()
            known = self._enclaves.get(prefix)
        return known

    def writer(self, handle: bytes) -> bytes:
        """Return the GUID of the writer with this GID (rmw_cyclonedds_cpp's instance handle); b"" if unknown yet."""
        return self._guid(self._writers, int.from_bytes(handle[:8], "little"))

    def entity(self, data: int, gid: bytes) -> int:
        """Return the entity of a publisher's writer, which is the first member of rmw_cyclonedds_cpp's structure.

        Raises `MessageTypeError` if this rmw_cyclonedds_cpp has another structure (``CddsEntity`` in its rmw_node.cpp).

        Args:
            data: the address of the structure (``rmw_publisher_t.data``).
            gid: the GID that rmw_cyclonedds_cpp reports: the instance handle of the writer.
        """
        writer, handle = c_int32.from_address(data).value, c_uint64()
        if self._dds.dds_get_instance_handle(writer, byref(handle)) or handle.value.to_bytes(8, "little") != gid[:8]:
            raise MessageTypeError(
                "ROS 2 services are not bridged: this version of rmw_cyclonedds_cpp is unknown", "remove ros2.rmw"
            )
        return writer

    def matched_readers(self, writer: int) -> frozenset[bytes]:
        """Return the GUIDs of the readers that a writer (its `entity`) has matched; b"" for an unknown reader."""
        call, room, count = self._dds.dds_get_matched_subscriptions, 0, _MATCHED
        while count > room:
            room, handles = count, (c_uint64 * count)()
            count = self._check("dds_get_matched_subscriptions", call(writer, handles, room))
        return frozenset(self._guid(self._readers, handle) for handle in handles[:count])

    def _guid(self, endpoints: _Endpoints, handle: int) -> bytes:
        known = endpoints.guids.get(handle)
        if known is None:
            with self._lock:
                for info, sample in self._samples(endpoints.reader):
                    endpoints.add(info.instance, string_at(sample, _GUID_BYTES), alive=info.instance_state == _ALIVE)
            known = endpoints.guids.get(handle, b"")
        return known

    def _read_participants(self) -> None:
        for info, sample in self._samples(self._participants):
            participant = _Participant.from_address(sample)
            prefix = bytes(participant.guid)[:PREFIX_BYTES]
            if info.valid:
                self._enclaves[prefix] = _enclave(self._user_data(participant.qos))
            if info.instance_state != _ALIVE:
                self._departed.append(prefix)
        while len(self._departed) > _DEPARTED:
            self._enclaves.pop(self._departed.popleft(), None)

    def _samples(self, reader: int) -> Iterator[tuple[_Info, int]]:
        """Yield all samples, each with its address; none once the participant is destroyed. The lock is held."""
        while True:
            self._buffers[0] = None  # Cyclone DDS lends the samples
            count = self._dds.dds_take(reader, self._buffers, self._infos, _BATCH, _BATCH)
            if count <= 0:
                return
            for position in range(count):
                yield self._infos[position], int(self._buffers[position] or 0)
            self._dds.dds_return_loan(reader, self._buffers, count)

    def _user_data(self, qos: int | None) -> bytes:
        value, size = c_void_p(), c_size_t()
        if not qos or not self._dds.dds_qget_userdata(qos, byref(value), byref(size)) or not value.value:
            return b""
        try:
            return string_at(value.value, size.value)
        finally:
            self._dds.dds_free(value)


def _enclave(user_data: bytes) -> str:
    """Return the enclave in a participant's user data, which ROS 2 writes as ``enclave=/name;``."""
    for entry in user_data.split(b";"):
        key, _, value = entry.partition(b"=")
        if key == b"enclave":
            return value.decode("utf-8", "replace")
    return ""
