"""The configured content of a YARP port: the converter's Bottle, chosen fields, or the natural type."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from typing_extensions import override

from bridge.messages import values
from bridge.messages.definitions.schema import Schema
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.messages.yarp.bottle import BottleCodec
from bridge.messages.yarp.codec import Codec, EncodedMessage, Missing, NaturalType, has_header, stamp_of
from bridge.messages.yarp.fields import BottleEntry, FieldsCodec
from bridge.messages.yarp.navigation import NAVIGATION
from bridge.messages.yarp.plain import CLOCK, PLAIN
from bridge.messages.yarp.sensors import SENSORS
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile

Form = Literal["bottle", "fields", "natural"]


@dataclass(frozen=True, slots=True)
class Content:
    """The content of a port."""

    # the format of messages; "natural" sends types without a natural form as Bottles, and "bottle" sends a clock in
    # its natural form
    form: Form = "bottle"
    fields: tuple[BottleEntry, ...] = ()  #: the entries of the Bottle of chosen fields
    profile: Profile = Profile.YARP3  #: format of written bytes, and of read bytes whose format is not recognizable
    missing: Missing = field(default_factory=Missing)  #: values that YARP's types lack

    def codec(self, registry: Registry, type_name: str, type_hash: str = "") -> Codec:
        """Return the converter of a type; raises `MessageTypeError` if the type is unknown or lacks this form."""
        schema = registry.schema(type_name, type_hash)
        if self.form == "fields":
            return FieldsCodec(schema, self.fields, self.profile, self.missing.frame)
        if self._is_natural(type_name):
            return NaturalCodec(schema, self.profile, self.missing)
        return BottleCodec(registry, type_name, type_hash, self.profile)

    def shown(self, type_name: str) -> str:
        """Return a description of the content, for people."""
        if self.form == "fields":
            return "fields " + " ".join(entry.text for entry in self.fields)
        return "natural" if self._is_natural(type_name) else "bottle"

    def _is_natural(self, type_name: str) -> bool:
        return (self.form == "natural" and type_name in KINDS) or type_name == CLOCK


KINDS: Mapping[str, NaturalType] = {**SENSORS, **NAVIGATION, **PLAIN}  # natural types by the message's ROS 2 name


class NaturalCodec(Codec):
    """Converts messages to the YARP type with the same meaning."""

    def __init__(self, schema: Schema, profile: Profile, missing: Missing) -> None:
        self._schema, self._profile, self._missing = schema, profile, missing
        self._kind = KINDS[schema.name]
        self._stamped = has_header(schema)

    @override
    def to_yarp(self, cdr: bytes) -> EncodedMessage:
        out = ElementWriter(self._profile)
        try:
            self._kind.to_yarp(values.MessageReader(self._schema, cdr).message(), out)
        except WireError as err:
            raise ConversionError(str(err)) from None
        return EncodedMessage(out.buffers(), (stamp_of(cdr) or None) if self._stamped else None)

    @override
    def to_hub(self, payload: Buffer, profile: Profile | None, stamp_ns: int | None) -> bytes:
        wrong: WireError | None = None
        time_ns = self.now_ns() if stamp_ns is None else stamp_ns
        for known in Profile if profile is None else (profile,):
            source = ElementReader(payload, known)
            try:
                message = self._kind.to_ros(source, time_ns, self._missing)
                source.finish()
            except WireError as err:
                wrong = wrong or err
                continue
            return values.MessageWriter(self._schema).message(message)
        raise ConversionError(f"not what YARP sends for a {self._schema.name}: {wrong}")
