"""Messages as the YARP type that says the same."""

from __future__ import annotations

from collections.abc import Mapping

from bridge.messages import values
from bridge.messages.definition import Schema
from bridge.messages.errors import ConversionError
from bridge.messages.yarp.codec import Codec, Outgoing, is_stamped, stamp_of
from bridge.messages.yarp.natural import clock, cloud, motion, picture, places, plain, scan
from bridge.messages.yarp.natural.kind import Kind, Missing
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer

KINDS: Mapping[str, Kind] = {
    **scan.KINDS,
    **picture.KINDS,
    **cloud.KINDS,
    **motion.KINDS,
    **places.KINDS,
    **plain.KINDS,
    **clock.KINDS,
}
"""What there is, by the message's ROS 2 name."""


class NaturalCodec(Codec):
    """Messages as the YARP type that says the same.

    Args:
        schema: the ROS 2 type, one of `KINDS`.
        profile: of the ports that are written to.
        missing: what YARP's type does not say.
    """

    def __init__(self, schema: Schema, profile: Profile, missing: Missing) -> None:
        self._schema, self._profile, self._missing = schema, profile, missing
        self._kind = KINDS[schema.name]
        self._stamped = is_stamped(schema)

    def to_yarp(self, cdr: bytes) -> Outgoing:
        """See `Codec`."""
        out = Writer(self._profile)
        try:
            self._kind.to_yarp(values.Reader(self._schema, cdr).message(), out)
        except WireError as err:
            raise ConversionError(str(err)) from None
        return Outgoing(out.buffers(), (stamp_of(cdr) or None) if self._stamped else None)

    def to_hub(self, payload: Buffer, profile: Profile | None, stamp_ns: int | None) -> bytes:
        """See `Codec`."""
        wrong: WireError | None = None
        time_ns = self.now_ns() if stamp_ns is None else stamp_ns
        for known in Profile if profile is None else (profile,):
            source = Reader(payload, known)
            try:
                message = self._kind.to_ros(source, time_ns, self._missing)
                source.finish()
            except WireError as err:
                wrong = wrong or err
                continue
            return values.Writer(self._schema).message(message)
        raise ConversionError(f"not what YARP sends for a {self._schema.name}: {wrong}")
