"""What a port carries, as the configuration says it: the converter's Bottle, chosen fields, or the natural type."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from bridge.messages.registry import Registry
from bridge.messages.yarp.bottle import BottleCodec
from bridge.messages.yarp.codec import Codec
from bridge.messages.yarp.fields import Entry, FieldsCodec
from bridge.messages.yarp.natural.clock import CLOCK
from bridge.messages.yarp.natural.codec import KINDS, NaturalCodec
from bridge.messages.yarp.natural.kind import Missing
from yarp_compat.wire.profile import Profile

Form = Literal["bottle", "fields", "natural"]


@dataclass(frozen=True, slots=True)
class Content:
    """What a port carries.

    Attributes:
        form: how messages look there; a type that has no natural form is a Bottle, and a clock is always YARP's.
        fields: what stands in the Bottle of chosen fields.
        profile: whose bytes are written, and read where they do not tell.
        missing: what YARP's types do not say.
    """

    form: Form = "bottle"
    fields: tuple[Entry, ...] = ()
    profile: Profile = Profile.YARP3
    missing: Missing = field(default_factory=Missing)

    def codec(self, registry: Registry, type_name: str, type_hash: str = "") -> Codec:
        """The converter of a type.

        Raises:
            MessageTypeError: the type is unknown, or cannot be said so.
        """
        schema = registry.schema(type_name, type_hash)
        if self.form == "fields":
            return FieldsCodec(schema, self.fields, self.profile, self.missing.frame)
        if self._is_natural(type_name):
            return NaturalCodec(schema, self.profile, self.missing)
        return BottleCodec(registry, type_name, type_hash, self.profile)

    def shown(self, type_name: str) -> str:
        """The content in words, for people."""
        if self.form == "fields":
            return "fields " + " ".join(entry.text for entry in self.fields)
        return "natural" if self._is_natural(type_name) else "bottle"

    def _is_natural(self, type_name: str) -> bool:
        return (self.form == "natural" and type_name in KINDS) or type_name == CLOCK
