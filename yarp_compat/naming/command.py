"""One command to a name server: its words, and what comes of it besides the answer."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from yarp_compat.naming.answers import OLD
from yarp_compat.naming.subscriptions import Wish
from yarp_compat.wire.contact import Contact
from yarp_compat.wire.text import plain_text


@dataclass(slots=True)
class Command:
    """A command being answered: its words, whether as Bottle (``bot``), from which address, and what came of it."""

    words: Sequence[Any]
    bot: bool
    remote: str
    events: list[list[Any]] = field(default_factory=list)
    wishes: list[Wish] = field(default_factory=list)
    changed: bool = False

    def word(self, index: int) -> str:
        """A word of it as text; empty where there are fewer."""
        return plain_text(self.words[index]) if index < len(self.words) else ""

    def name(self, index: int) -> str:
        """A word of it that is a string; empty where it is anything else (a browser's request has lists behind)."""
        value = self.words[index] if index < len(self.words) else ""
        return str(value) if isinstance(value, str) else ""

    @property
    def head(self) -> list[Any]:
        """How an answer begins that says nothing."""
        return [] if self.bot else [OLD]


def plain_name(name: str) -> str:
    """A name without carrier and without the network that was asked for (``/net=eth0/p``)."""
    name = Contact.parse(name).name if ":/" in name else name
    if name[:5].lower() == "/net=" and "/" in name[5:]:
        return name[name.index("/", 5) :]
    return name


def wants_json(words: Sequence[Any]) -> bool:
    """Whether a browser's request asks for json, which needs values instead of lines."""
    return ["format", "json"] in words or ("format", "json") in itertools.pairwise(words)
