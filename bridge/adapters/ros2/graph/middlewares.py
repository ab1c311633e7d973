"""The DDS and the ROS 2 release of each participant, by its GUIDs, announcements and type hashes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from typing_extensions import override

from bridge.adapters.ros2.graph.origins import PREFIX_BYTES, is_secured
from bridge.messages import releases
from bridge.messages.releases import Release, Releases
from bridge.routing.edge import Endpoint, MadeBy
from bridge.status import Middleware

_VENDORS = {
    b"\x01\x01": "RTI Connext",
    b"\x01\x02": "OpenSplice",
    b"\x01\x03": "OpenDDS",
    b"\x01\x0a": "RTI Connext Micro",
    b"\x01\x0f": "Fast DDS",
    b"\x01\x10": "Cyclone DDS",
    b"\x01\x11": "GurumDDS",
    b"\x01\x12": "RustDDS",
}
"""By the first two bytes of a GUID (DDSI-RTPS 2.5, 9.3.1.5; the OMG's list of vendors)."""

_FAST = b"\x01\x0f"
_FAST_2 = frozenset({Release.HUMBLE, Release.IRON, Release.JAZZY})
_KILTEDS = (3, 2)
"""Kilted's Fast DDS."""
_SHOWN = 100
_UNNAMED = "a node with an unknown name"


def dds_name(prefix: bytes, version: str | None) -> str:
    """Return the DDS of a participant; ``version`` is "" if it announces none, None if it is not known."""
    if is_secured(prefix):
        return "DDS in a secured domain"
    vendor = prefix[:2]
    name = _VENDORS.get(vendor, f"an unknown DDS (vendor {vendor.hex(' ')})")
    if version is None:
        return name
    if vendor == _FAST:  # Fast DDS 2 announces no version
        version = version or "2"
    return f"{name} {version}".rstrip()


def _by_version(prefix: bytes, version: str | None) -> Releases:
    """Return the releases with this version of Fast DDS.

    Returns all releases if the version is not known, and for another DDS, because releases share that DDS's versions.
    """
    if prefix[:2] != _FAST or version is None:
        return releases.ALL
    if not version:
        return _FAST_2
    major, minor, *_ = (int(part) for part in version.split("."))
    if (major, minor) <= _KILTEDS:
        return frozenset({Release.KILTED})
    return frozenset({Release.LYRICAL})


class Program(NamedTuple):
    """The DDS and the releases of one participant, as `bridge.status.Middleware` describes them."""

    name: str
    release: str
    ros: bool
    hashes: bool

    @override
    def __str__(self) -> str:
        return str(Middleware(name=self.name, release=self.release, ros=self.ros, hashes=self.hashes))


def prefix_of(endpoint: Endpoint) -> bytes:
    """Return the GUID prefix of an endpoint's participant."""
    return bytes.fromhex(endpoint.id)[:PREFIX_BYTES]


def programs(
    endpoints: Iterable[Endpoint], participants: frozenset[bytes], versions: Mapping[bytes, str]
) -> dict[bytes, tuple[Program, list[Endpoint]]]:
    """Return the native programs with their endpoints, by GUID prefix; the arguments are those of `groups`."""
    of_participant: dict[bytes, list[Endpoint]] = {}
    for endpoint in endpoints:
        if endpoint.made_by is MadeBy.NATIVE:
            of_participant.setdefault(prefix_of(endpoint), []).append(endpoint)
    found: dict[bytes, tuple[Program, list[Endpoint]]] = {}
    for prefix, ends in of_participant.items():
        ros, version = prefix in participants, versions.get(prefix)
        hashed = [end for end in ends if end.type_id]
        announced = [releases.by_hash(end.type, end.type_id) for end in hashed] or [releases.WITHOUT_HASHES]
        release = releases.release_text(releases.common([*announced, _by_version(prefix, version)])) if ros else ""
        found[prefix] = Program(dds_name(prefix, version), release, ros, bool(hashed)), ends
    return found


def groups(
    endpoints: Iterable[Endpoint], participants: frozenset[bytes], versions: Mapping[bytes, str]
) -> list[dict[str, Any]]:
    """Return the native programs by DDS and release, as `bridge.status.Middleware` describes them.

    Args:
        endpoints: all endpoints of the graph.
        participants: the GUID prefixes of ROS 2 programs; others that have endpoints are plain DDS programs.
        versions: what participants announce, by GUID prefix.
    """
    found: dict[Program, list[list[str]]] = {}
    for program, ends in programs(endpoints, participants, versions).values():
        found.setdefault(program, []).append(sorted({end.node for end in ends} - {""}) or [_UNNAMED])
    return [
        {
            **program._asdict(),
            "nodes": sorted({node for nodes in of_programs for node in nodes})[:_SHOWN],
            "count": len(of_programs),
        }
        for program, of_programs in sorted(found.items())
    ]
