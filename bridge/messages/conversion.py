"""A message type as one side names it, and the way of its bytes from one wire to another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SideType:
    """A message type as one side names it.

    Attributes:
        name: as the side spells it.
        type_id: md5 sum on ROS 1, RIHS01 hash (``RIHS01_<64 hex>``) on ROS 2 and the hub.
        definition: full text: the type's own definition, then each nested type's after a line of ``=`` and one of
            ``MSG: name``.
    """

    name: str
    type_id: str
    definition: str


@dataclass(frozen=True, slots=True)
class Conversion:
    """How one type's bytes get from one wire to another; ``convert`` is None where the bytes are the same.

    ``convert(payload: bytes) -> bytes`` raises `bridge.messages.errors.ConversionError` for a bad message.
    ``left_out`` names the fields of a ROS 1 message that get lost, because the target has none for them.
    """

    source: SideType
    target: SideType
    convert: Callable[[bytes], bytes] | None
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ServiceConversion:
    """How a service's requests and replies get from one wire to another; the same for calls in both directions.

    Each is ``convert(payload: bytes) -> bytes`` and raises `bridge.messages.errors.ConversionError`; None where the
    bytes are the same.

    Attributes:
        side: the service type as the side names it (ROS 1: ``std_srvs/SetBool`` and md5).
        hub: as ROS 2 names it (``std_srvs/srv/SetBool`` and the service's RIHS01). The definition of either is the
            request's full text, a line ``---``, and the response's.
        left_out: the fields of ROS 1's request and response that get lost, because the hub's have none for them.
    """

    side: SideType
    hub: SideType
    request_to_side: Callable[[bytes], bytes] | None
    request_to_hub: Callable[[bytes], bytes] | None
    response_to_side: Callable[[bytes], bytes] | None
    response_to_hub: Callable[[bytes], bytes] | None
    left_out: tuple[str, ...] = ()
