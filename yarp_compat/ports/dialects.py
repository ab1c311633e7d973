"""The dialect of another port, of this process or any other."""

from __future__ import annotations

from yarp_compat.naming.dialect import asked
from yarp_compat.naming.naming import Naming
from yarp_compat.ports import process
from yarp_compat.wire.contact import Contact
from yarp_compat.wire.profile import Profile


def dialect_of(naming: Naming, name: str) -> Profile | None:
    """What the port of a name says of its dialect; takes a while, see :func:`yarp_compat.naming.dialect.asked`."""
    try:
        contact = naming.query(name)
    except OSError:
        return None
    return dialect_at(contact) if contact is not None and contact.is_valid else None


def dialect_at(contact: Contact) -> Profile | None:
    """The same of the port at a place."""
    there = process.find(contact)
    return asked(contact) if there is None else there.profile
