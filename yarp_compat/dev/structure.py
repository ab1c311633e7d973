"""Structures: lists of fields in their order, as generated (thrift) classes write them."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import get_type_hints

from yarp_compat.dev.fields import Field, field_of
from yarp_compat.wire.binary import decode
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.text import to_text
from yarp_compat.wire.writer import Writer


class Structure(Portable):
    """A dataclass whose annotated fields go on the wire, see :mod:`yarp_compat.dev.fields`."""

    def _write(self, out: Writer) -> None:
        fields = fields_of(type(self))
        out.begin(len(fields))
        name = ""
        try:
            for name, field in fields:
                field.write(out, getattr(self, name))
        except WireError as error:
            raise type(error)(f"{type(self).__name__}.{name}: {error}") from None

    def _read(self, source: Reader) -> None:
        fields = fields_of(type(self))
        count = source.begin()
        if count != len(fields):
            raise WireError(f"a {type(self).__name__} has {len(fields)} fields, not {count}")
        found = {}
        name = ""
        try:
            for name, field in fields:
                found[name] = field.read(source)
        except WireError as error:
            raise type(error)(f"{type(self).__name__}.{name}: {error}") from None
        source.end()
        for name, value in found.items():
            setattr(self, name, value)


class Generated(Structure):
    """A structure whose C++ class is generated, so that its text is a Bottle's; others have words of their own."""

    def toString(self) -> str:
        """The fields as a Bottle's text."""
        return to_text(decode(self.to_bytes(Profile.YARP3), Profile.YARP3))


@cache
def fields_of(kind: type[Structure]) -> tuple[tuple[str, Field], ...]:
    """A structure's fields in their order, by name."""
    hints = get_type_hints(kind, include_extras=True)
    fields = dataclasses.fields(kind)  # type: ignore[arg-type] # structures are dataclasses
    return tuple((field.name, field_of(hints[field.name])) for field in fields)
