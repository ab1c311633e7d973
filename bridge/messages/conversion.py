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
