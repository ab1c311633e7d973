"""The four generations of replies, and which of them a peer is answered in: the one place that decides it.

YARP's generated (thrift) services have answered with a bool, a bare number, a tagged number and a list, in turn; the
requests never changed, so nothing in them tells the first three apart.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from fnmatch import fnmatchcase

from yarp_compat.wire.profile import Profile

MOST_PEERS = 4096
"""Peers whose own words are remembered; the longest known goes first."""


class Generation(Enum):
    """How a release of YARP writes what a call returned; its value is the first release that did so."""

    YARP_3_6 = "3.6"
    """A bool: the vocab ``[ok]`` or ``[fail]``."""
    YARP_3_11 = "3.11"
    """An int64 without a tag."""
    YARP_3_12 = "3.12"
    """An int32 with its tag."""
    YARP_4 = "4.0"
    """A list of one vocab: ``([ok])``, ``([err1])`` to ``([err7])``."""

    @property
    def profile(self) -> Profile:
        """The Bottle tags that this generation writes."""
        return Profile.YARP4 if self is Generation.YARP_4 else Profile.YARP3

    @classmethod
    def of(cls, version: str) -> Generation:
        """The generation of a release of YARP.

        Args:
            version: such as ``3.9.1`` or ``4``.

        Raises:
            ValueError: this is no version of YARP from 3.6 on.
        """
        match = re.fullmatch(r"(\d{1,4})(?:\.(\d{1,4}))?(?:\.\d{1,8})?\+?", version.strip())
        release = (int(match[1]), int(match[2] or 0)) if match else (0, 0)
        if match and match[2] is None and release[0] == 3:
            release = (3, 12)
        for generation in reversed(cls):
            first = tuple(map(int, generation.value.split(".")))
            if release >= first:
                return generation
        msg = f"{version!r} is no version of YARP that this knows: give one from 3.6 on, such as 3.9, 3.12 or 4.0"
        raise ValueError(msg)

    @classmethod
    def newest(cls, profile: Profile) -> Generation:
        """The generation to expect where only the Bottle tags are known."""
        return cls.YARP_4 if profile is Profile.YARP4 else cls.YARP_3_12


@dataclass(frozen=True, slots=True)
class Decision:
    """What a peer is answered in, and why."""

    peer: str
    generation: Generation
    reason: str

    def as_dict(self) -> dict[str, str]:
        """Generation and reason, for a status document."""
        return {"generation": self.generation.value, "generation_why": self.reason}


class Generations:
    """Decides for each peer of a name server, and remembers what the peers told of themselves.

    Args:
        default: what peers on this name server are taken for.
        rules: patterns of port names (``/cer/*``) and what those are taken for, the first that fits.
        older: what a peer is taken for whose bytes are YARP 3's where everything else says 4.0.
    """

    def __init__(
        self,
        default: Generation = Generation.YARP_3_12,
        rules: Sequence[tuple[str, Generation]] = (),
        older: Generation = Generation.YARP_3_12,
    ) -> None:
        self._default = default
        self._rules = tuple(rules)
        self._older = older
        self._told: dict[str, tuple[Generation, str]] = {}
        self._lock = threading.Lock()

    def introduced(self, peer: str, profile: Profile | None = None) -> None:
        """The peer asked for the protocol's version, as clients of 4.0 do, and some of 3.12.

        Args:
            peer: its name.
            profile: its dialect, where that is known.
        """
        asked = "it asked for the protocol's version"
        if profile is Profile.YARP3:
            self._remember(peer, Generation.YARP_3_12, f"{asked}, and is of YARP 3, of which only 3.12 does")
        else:
            self._remember(peer, Generation.YARP_4, f"{asked}, as clients of 4.0 do")

    def recognised(self, peer: str, profile: Profile) -> None:
        """The peer wrote bytes that only one profile explains: that outweighs all else, also an introduction.

        (Clients of services of one's own may introduce themselves in 3.12 too.)
        """
        if profile is self.of(peer).generation.profile:
            return
        found = Generation.YARP_4 if profile is Profile.YARP4 else self._older
        self._remember(peer, found, _bytes_of(profile))

    def of(self, peer: str, profile: Profile | None = None) -> Decision:
        """What this peer, a port's name, is answered in.

        Args:
            peer: its name.
            profile: its dialect, where that is known without its ever having called: it outweighs the rules.
        """
        told = self._told.get(peer)
        if told is not None:
            return Decision(peer, *told)
        decision = self._ruled(peer)
        if profile in (None, decision.generation.profile):
            return decision
        return Decision(peer, Generation.YARP_4 if profile is Profile.YARP4 else self._older, _bytes_of(profile))

    def _ruled(self, peer: str) -> Decision:
        for pattern, generation in self._rules:
            if fnmatchcase(peer, pattern):
                return Decision(peer, generation, f"the rule for {pattern} says so")
        return Decision(peer, self._default, "its name server's generation")

    def forget(self, peer: str) -> None:
        """The peer's connection is gone; its next one may be another release's."""
        with self._lock:
            self._told.pop(peer, None)

    def explain(self) -> list[Decision]:
        """Every peer that told of itself, the longest known first."""
        with self._lock:
            return [Decision(peer, *told) for peer, told in self._told.items()]

    def _remember(self, peer: str, generation: Generation, reason: str) -> None:
        with self._lock:
            self._told[peer] = generation, reason
            while len(self._told) > MOST_PEERS:
                del self._told[next(iter(self._told))]


def _bytes_of(profile: Profile | None) -> str:
    return f"its bytes are YARP {'4' if profile is Profile.YARP4 else '3'}'s"
