"""The Fast DDS profile of the worker's participant: transports, marked GUID prefix, announcements.

Measured with Fast DDS 2.14.5, against nodes with its default settings:

- Between different users, shared memory delivers nothing although the graph is complete, because each user's
  shared-memory files are unreadable to others. If this end uses only UDP, data is delivered in both directions, and the
  other end needs no change.
- The discovery range LOCALHOST makes rmw_fastrtps add shared memory again. So this profile limits the range itself:
  the white list admits only loopback. The participant discovers the machine's nodes by multicast on loopback, and nodes
  that do not listen to multicast (their range is LOCALHOST) by unicast to the ports of the first 32 participants.
- The default queue of a participant's shared memory (512) overflows in a burst. A reader reports lost messages after
  the writer's next heartbeat, by default every 3 s, and delivers no later message until then: ``/tf`` paused for up to
  2.6 s, with a heartbeat every 0.5 s for up to 0.5 s. The more frequent heartbeats cost no measurable processor time
  with 500 topics at 10 Hz.
- The default shared-memory segment (512 kB) makes a message of 1 MB five times slower than a large segment.
- The kernel's default receive buffer is too small for large best-effort messages over UDP: see
  `bridge.adapters.ros2.receive_buffers`.
- With the range SYSTEM_DEFAULT, rmw_fastrtps ignores ``ROS_STATIC_PEERS``. So this profile contains the static peers.
- By default (0 s) the NACK suppression of a reliable writer wakes the timer thread after each sample, which then waits
  for the writer's lock: two thread switches per message.
- Other participants notice a killed participant after its lease, 20 s by default; `bridge.adapters.ros2.graph.spdp`
  explains why the lease is not shortened.
"""

from __future__ import annotations

import atexit
import logging
import os
import socket
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from bridge.adapters.ros2 import profile_file, rcl, receive_buffers
from bridge.adapters.ros2.environment import STATIC_PEERS, SWITCHES, UNSET
from bridge.adapters.ros2.graph import neighbors
from bridge.adapters.ros2.graph.origins import ALL_NUMBERS, new_prefix, participant_number, stored_prefixes
from bridge.adapters.ros2.graph.spdp import MULTICAST, PARTICIPANTS
from bridge.adapters.ros2.releases import current
from bridge.config.model import Config
from bridge.hub.shared_memory import FOLDER, RESTART, room_trouble
from bridge.state_file import keep

_log = logging.getLogger(__name__)

_NAMESPACE = "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"
_QUEUE = "8192"
"""Limit of the messages in this participant's shared memory that Fast DDS has not read yet."""

_HEARTBEAT_NS = "500000000"
"""Nanoseconds between a writer's heartbeats while samples are not acknowledged; each prompts readers to request what
they missed."""

_NACK_SUPPRESSION_NS = "100000000"
"""Nanoseconds after a sample during which a NACK for it is ignored, and the timer thread sleeps.

The reader repeats an ignored NACK after the next heartbeat.
"""


_PROPERTIES = {
    # the participant's own writers and readers ignore each other
    "fastdds.ignore_local_endpoints": "true",
    # Fast DDS 3 announces the definitions of types, and matches endpoints only if they are equal; here they are those
    # of a lent type support (`bridge.adapters.ros2.types`). Without definitions it compares names, like Fast DDS 2.
    "fastdds.type_propagation": "disabled",
}


@dataclass(frozen=True, slots=True)
class FastDdsProfile:
    """The profile of the participant.

    Attributes:
        prefix: its marked GUID prefix (12 bytes).
        segment: its shared memory in bytes; 0: only UDP.
        localhost_only: whether it communicates only with participants on this machine.
        peers: addresses of machines to announce itself to, see `static_peers`.
    """

    prefix: bytes
    segment: int
    localhost_only: bool
    peers: tuple[str, ...] = ()

    def xml(self) -> str:
        """Return the profile as a Fast DDS XML document."""
        root = ET.Element("dds", xmlns=_NAMESPACE)
        profiles = ET.SubElement(root, "profiles")
        transports = ET.SubElement(profiles, "transport_descriptors")
        names = ["shm", "udp"] if self.segment else ["udp"]
        if self.segment:
            self._shared_memory(ET.SubElement(transports, "transport_descriptor"))
        self._udp(ET.SubElement(transports, "transport_descriptor"))
        participant = ET.SubElement(profiles, "participant", profile_name="midspan", is_default_profile="true")
        rtps = ET.SubElement(participant, "rtps")
        user_transports = ET.SubElement(rtps, "userTransports")
        for name in names:
            _add_texts(user_transports, transport_id=name)
        _add_texts(rtps, useBuiltinTransports="false")
        self._builtin(ET.SubElement(rtps, "builtin"))
        _add_texts(rtps, participantID=str(participant_number(self.prefix)))
        _set_prefix(rtps, self.prefix)
        self._writers(profiles)
        return ET.tostring(root, encoding="unicode", xml_declaration=True)

    def _shared_memory(self, descriptor: ET.Element) -> None:
        size, largest = str(self.segment), str(self.segment // 4)
        _add_texts(descriptor, transport_id="shm", type="SHM", segment_size=size, maxMessageSize=largest)
        _add_texts(descriptor, port_queue_capacity=_QUEUE)

    def _udp(self, descriptor: ET.Element) -> None:
        buffer = str(receive_buffers.WANTED)
        _add_texts(descriptor, transport_id="udp", type="UDPv4", sendBufferSize=buffer, receiveBufferSize=buffer)
        # a machine in `peers` may have another Midspan daemon, whose participant has a high number
        _add_texts(descriptor, maxInitialPeersRange=str(ALL_NUMBERS if self.peers else PARTICIPANTS))
        if self.localhost_only:
            _add_texts(ET.SubElement(descriptor, "interfaceWhiteList"), address="127.0.0.1")

    def _writers(self, profiles: ET.Element) -> None:
        writer = ET.SubElement(profiles, "data_writer", profile_name="midspan_writer", is_default_profile="true")
        times = ET.SubElement(writer, "times")
        for name, nanoseconds in zip(current().writer_times, (_HEARTBEAT_NS, _NACK_SUPPRESSION_NS), strict=True):
            _add_texts(ET.SubElement(times, name), sec="0", nanosec=nanoseconds)

    def _builtin(self, builtin: ET.Element) -> None:
        discovery = ET.SubElement(builtin, "discovery_config")
        _add_texts(ET.SubElement(discovery, "leaseAnnouncement"), sec="0", nanosec="500000000")
        peers = ET.SubElement(builtin, "initialPeersList")
        for address in (MULTICAST, "127.0.0.1", *self.peers):
            _add_texts(ET.SubElement(ET.SubElement(peers, "locator"), "udpv4"), address=address)


def static_peers(environ: Mapping[str, str]) -> list[str]:
    """Return the machines in ``ROS_STATIC_PEERS``, separated by semicolons (rcl, discovery_options.c)."""
    return list(dict.fromkeys(filter(None, map(str.strip, environ.get(STATIC_PEERS, "").split(";")))))


def addresses(peers: Iterable[str]) -> Iterator[str]:
    """Yield the IPv4 addresses of machines; log those that have none."""
    for peer in peers:
        try:
            yield socket.gethostbyname(peer)
        except (OSError, UnicodeError) as err:  # the latter for a name with an empty or too long part
            _log.warning(
                "%s: %s is not a known machine (%s); correct it or add it to /etc/hosts", STATIC_PEERS, peer, err
            )


def stamped(own: Path, prefix: bytes) -> str:
    """Return a user's profile with Midspan's mark in its default participant; raises `ValueError` or `OSError`."""
    root, rtps = profile_file.whole(own)
    _set_prefix(rtps, prefix)
    root.set("xmlns", _NAMESPACE)
    return ET.tostring(root, encoding="unicode", xml_declaration=True)


def _set_prefix(rtps: ET.Element, prefix: bytes) -> None:
    """Set the prefix and the participant's properties."""
    for old in rtps.findall("prefix"):
        rtps.remove(old)
    _add_texts(rtps, prefix=prefix.hex("."))
    properties = rtps
    for name in ("propertiesPolicy", "properties"):
        element = properties.find(name)
        properties = ET.SubElement(properties, name) if element is None else element
    for name, value in _PROPERTIES.items():
        _add_texts(ET.SubElement(properties, "property"), name=name, value=value)


def _add_texts(parent: ET.Element, **texts: str) -> None:
    for tag, text in texts.items():
        ET.SubElement(parent, tag).text = text


def use_profile(config: Config, state: Path) -> FastDdsProfile:
    """Write this process's Fast DDS profile. Fast DDS reads it once, so later calls return the first profile.

    Call `remove_temporary` after the first participant has been created. Raises `RuntimeError` if no folder can store
    the profile: Midspan's own topics would loop through an unmarked participant.
    """
    if _loaded:
        return _loaded[0]
    prefix = new_prefix(rcl.host_prefix(), stored_prefixes(state / "ros2"))
    custom, local = config.ros2.profile, config.ros2.localhost_only
    peers = tuple(addresses(static_peers(os.environ))) if custom is None and not local else ()
    profile = FastDdsProfile(prefix, _segment(config, state), local, peers)
    try:
        text = profile.xml() if custom is None else stamped(custom, profile.prefix)
    except ValueError as err:  # the file has changed since the configuration was checked
        raise RuntimeError(f"ros2.profile: {err}") from None
    path = state / "ros2" / "fastdds.xml"
    if not keep(path, text, "trying another folder for the Fast DDS profile"):
        path = _write_elsewhere(text, path.parent)
    for name in (*UNSET, "FASTRTPS_DEFAULT_PROFILES_FILE"):
        os.environ.pop(name, None)
    os.environ.update(SWITCHES[config.ros2.rmw] | dict.fromkeys(current().profile_variables, str(path)))
    _loaded.append(profile)
    return profile


_loaded: list[FastDdsProfile] = []
"""The profile that Fast DDS has loaded in this process."""

_temporary: list[Path] = []
"""The file of the profile outside of the state folder, until `remove_temporary`."""


def _write_elsewhere(text: str, refused: Path) -> Path:
    """Write the profile to the first usable folder outside of the state folder, which has ``refused`` it.

    It must be a regular file: Fast DDS resolves links, and cannot open the target of a descriptor in ``/proc``.
    """
    failures = []
    for folder in _other_folders():
        try:
            # readable only to this user, under a new name, since other users can write to some of these folders
            file, name = tempfile.mkstemp(".xml", f"midspan-{os.getpid()}-", folder)
            path = Path(name)
            try:
                with os.fdopen(file, "w", encoding="utf-8") as stream:
                    stream.write(text)
            except OSError:
                path.unlink()
                raise
        except OSError as err:
            failures.append(f"{folder}: {err.strerror}")
            continue
        _temporary.append(path)
        atexit.register(remove_temporary)
        return path
    raise RuntimeError(
        f"cannot write the Fast DDS profile to {refused} or another folder ({'; '.join(failures)});"
        " free space in one of them, or set 'state' in the configuration to a writable folder"
    )


def _other_folders() -> Iterator[str]:
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if Path(runtime).is_absolute():
        yield runtime
    yield str(FOLDER)
    with suppress(FileNotFoundError):  # no folder for temporary files is usable
        yield tempfile.gettempdir()


def remove_temporary() -> None:
    """Remove the profile's file outside of the state folder, if there is one."""
    while _temporary:
        with suppress(OSError):
            _temporary.pop().unlink()


def _segment(config: Config, state: Path) -> int:
    transport = config.ros2.transport
    if transport == "udp":
        return 0
    major = current().fast_dds_major
    if transport == "auto" and (neighbors.has_other_users(major) or neighbors.prefers_udp(state / "ros2")):
        return 0
    size = neighbors.segment_size()
    if not size and config.ros2.profile is None:
        reason = room_trouble(neighbors.NEEDED_ROOM)
        _log.warning("Fast DDS uses only UDP, not shared memory: %s; then %s", reason, RESTART)
    return size
