"""The default content of a port: the Bottle that YARP's own converter makes of a ROS message.

Its fields are ROS 1's, as that converter knows no others: a header has its ``seq``, which ROS 2's has not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.messages.definition import Schema, World
from bridge.messages.errors import ConversionError
from bridge.messages.parser import closure, parse_full
from bridge.messages.registry import Registry
from bridge.messages.yarp.codec import Codec, Outgoing, is_stamped, stamp_of, with_stamp
from bridge.messages.yarp.layout import Layout, MismatchError
from bridge.messages.yarp.loose import to_ros1
from yarp_compat.wire import binary
from yarp_compat.wire.decoder import Data
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile

Convert = Callable[[bytes], bytes]


class RosBottle(Codec):
    """Messages as nested lists in field order.

    Args:
        schema: the ROS 1 type.
        to_ros1: makes its bytes of the hub's, and ``to_cdr`` the way back.
        profile: of the ports that are written to.
        stamped: it begins with a header.
    """

    def __init__(
        self, schema: Schema, to_ros1: Convert, to_cdr: Convert, profile: Profile, *, stamped: bool = False
    ) -> None:
        self._profile, self._stamped = profile, stamped
        self._to_ros1, self._to_cdr = to_ros1, to_cdr
        self._schema = schema
        self._layouts = {known: Layout(self._schema, known) for known in Profile}

    def to_yarp(self, cdr: bytes) -> Outgoing:
        """See `Codec`."""
        bottle = self._layouts[self._profile].to_bottle(self._to_ros1(cdr))
        return Outgoing([bottle], (stamp_of(cdr) or None) if self._stamped else None)

    def to_hub(self, payload: Buffer, profile: Profile | None, stamp_ns: int | None) -> bytes:
        """See `Codec`; a Bottle that people wrote by hand is taken too."""
        data = bytes(payload)
        try:
            ros1 = self._layouts[profile or self._profile].to_ros1(data)
        except MismatchError:
            ros1 = to_ros1(self._schema, decode_arrays(data, profile))
        cdr = self._to_cdr(ros1)
        return with_stamp(cdr, stamp_ns) if self._stamped else cdr


class BottleCodec(RosBottle):
    """Messages of one type as nested lists in field order.

    Raises:
        MessageTypeError: the type is unknown, or neither ROS 1 nor YARP can say it.
    """

    def __init__(self, registry: Registry, type_name: str, type_hash: str, profile: Profile) -> None:
        out = registry.hub_to_ros1(type_name, type_hash)
        back = registry.ros1_to_hub(out.target.name, out.target.type_id)
        assert out.convert is not None
        assert back.convert is not None
        stamped = is_stamped(registry.schema(type_name, type_hash))
        schema = ros1_schema(out.target.name, out.target.definition)
        super().__init__(schema, out.convert, back.convert, profile, stamped=stamped)
        self.ros1 = out.target


def ros1_schema(name: str, definition: str) -> Schema:
    """A ROS 1 type with all that it nests, from its full definition."""
    types = parse_full(definition, name, World.ROS1)
    return closure(types[name], types)


def decode_arrays(data: Data, profile: Profile | None) -> Any:
    """A Bottle's values; lists of numbers are arrays, the Bottle's own among them.

    Raises:
        ConversionError: it is no Bottle.
    """
    try:
        return binary.decode_arrays(data, profile)
    except WireError as err:
        raise ConversionError(f"no Bottle: {err}") from None
