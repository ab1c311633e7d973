"""A name server's answers: what they say of a port, and how they are sent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from yarp_compat.naming.subscriptions import Wish
from yarp_compat.wire.contact import Contact
from yarp_compat.wire.text import from_text, plain_text, to_text
from yarp_compat.wire.values import Vocab

OLD = "old"
"""The first word of an answer that is sent as lines of text, as YARP's oldest programs expect it."""

STYLE = (
    "body {\n  background: white;\n  color: black;\n  font-family: sans-serif;\n}\nh1 {\n  color: #336;\n}\n"
    "div {\n  padding-bottom: 10px;\n}\na {\n  color: #114499;\n  text-decoration: none;\n}\n"
)

HELP = (
    "+ help",
    "+ list [$prefix]",
    "+ register $portname",
    "+ register $portname $carrier $ipAddress $portNumber",
    "  (if you want a field set automatically, write '...')",
    "+ unregister $portname",
    "+ query $portname",
    "+ set $portname $property $value",
    "+ get $portname $property",
    "+ check $portname $property",
    "+ route $port1 $port2",
    "+ runners",
    "  (to get a list of the yarprun ports)",
)


@dataclass(frozen=True, slots=True)
class Answer:
    """What a command gives.

    Attributes:
        values: the reply as a Bottle's values; beginning with `OLD` it is sent as lines.
        events: what those who are connected to the name server's port are told: ``[add] /p`` and ``[del] /p``.
        wishes: connections to be made.
        changed: whether there is something to remember that was not there before.
    """

    values: list[Any]
    events: tuple[list[Any], ...] = ()
    wishes: tuple[Wish, ...] = ()
    changed: bool = False


def lines(values: Sequence[Any]) -> list[str]:
    """An answer that begins with `OLD`, as the lines that are sent, without their ends."""
    shown = [to_text(v).replace('"', "") if isinstance(v, list | tuple) else plain_text(v) for v in values[1:]]
    return [*filter(None, shown), "*** end of message"]


def as_words(c: Contact) -> list[Any]:
    """What is said of a port in lines."""
    return ["registration", "name", c.name, "ip", c.host, "port", c.port, "type", c.carrier]


def as_bottle(c: Contact) -> list[Any]:
    """What is said of a port as a Bottle."""
    return ["port", ["name", c.name], ["ip", c.host], ["port_number", c.port], ["carrier", c.carrier]]


def as_value(text: str) -> Any:
    """A property's word as the value that it was set to."""
    try:
        values = from_text(text)
    except ValueError:
        return text
    return values[0] if len(values) == 1 else text


def code(done: bool) -> list[Any]:
    """``[ok]`` or ``[fail]``."""
    return [Vocab("ok" if done else "fail")]
