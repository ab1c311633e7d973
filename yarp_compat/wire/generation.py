"""Decides in which of YARP's four generations of replies a peer is answered.

YARP's generated (thrift) services have answered with a bool, a bare number, a tagged number and a list, in turn. Few
requests tell who makes them: 4.0 asks for the protocol's version and has its own tags for numbers, and some methods
came with 3.12. Whom nothing tells apart is answered by a guess, and then with care, see `yarp_compat.dev.returnvalue`.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from fnmatch import fnmatchcase

from yarp_compat.wire.profile import Profile

MOST_PEERS = 4096  # peers whose own words are remembered; the longest known goes first


class Generation(Enum):
    """The way in which releases of YARP write a call's results; its value is the first such release."""

    YARP_3_6 = "3.6"  # a bool: the vocab ``[ok]`` or ``[fail]``
    YARP_3_11 = "3.11"  # an int64 without a tag
    YARP_3_12 = "3.12"  # an int32 with its tag
    YARP_4 = "4.0"  # a list of one vocab: ``([ok])``, ``([err1])`` to ``([err7])``

    @property
    def profile(self) -> Profile:
        """The Bottle tags that this generation writes."""
        return Profile.YARP4 if self is Generation.YARP_4 else Profile.YARP3

    @classmethod
    def of(cls, version: str) -> Generation:
        """The generation of a release of YARP, such as ``3.9.1`` or ``4``; raises `ValueError` for none from 3.6 on."""
        match = re.fullmatch(r"(\d{1,4})(?:\.(\d{1,4}))?(?:\.\d{1,8})?\+?", version.strip())
        release = (int(match[1]), int(match[2] or 0)) if match else (0, 0)
        if match and match[2] is None and release[0] == 3:
            release = (3, 12)
        for generation in reversed(cls):
            first = tuple(map(int, generation.value.split(".")))
            if release >= first:
                return generation
        raise ValueError(
            f"{version!r} is no version of YARP that this knows: give one from 3.6 on, such as 3.9, 3.12 or 4.0"
        )

    @classmethod
    def newest(cls, profile: Profile) -> Generation:
        """The generation to expect where only the Bottle tags are known."""
        return cls.YARP_4 if profile is Profile.YARP4 else cls.YARP_3_12


PeerAddress = tuple[str, int]  # the address of a connection, which tells two of one name apart
_NOWHERE: PeerAddress = ("", 0)


@dataclass(frozen=True, slots=True)
class GenerationDecision:
    """The generation for a peer, and the reason; ``cure`` says what would make a guess certain, else it is empty."""

    peer: str
    generation: Generation
    reason: str
    cure: str = ""

    @property
    def sure(self) -> bool:
        """Whether the peer or a setting has said it."""
        return not self.cure

    def as_dict(self) -> dict[str, str]:
        """Generation and reason, for a status document; and the cure of a guess."""
        said = {"generation": self.generation.value, "generation_why": self.reason}
        return said if self.sure else {**said, "generation_cure": self.cure}


class Generations:
    """Decides for each connection, and remembers what its peer disclosed."""

    def __init__(
        self,
        default: Generation | None = None,  # what peers on this name server are, where somebody said it
        # patterns of port names (``/cer/*``) and what those are, the first that fits
        rules: Sequence[tuple[str, Generation]] = (),
        *,
        guess: Generation = Generation.YARP_3_12,  # what peers count as where neither they nor any setting say it
        # how it can be said, for people; ``{peer}`` stands for the peer
        cure: str = "give the server the Generations of its peers",
    ) -> None:
        self._default, self._guess, self._cure = default, guess, cure
        self._rules = tuple(rules)
        self._told: dict[tuple[str, PeerAddress], GenerationDecision] = {}
        self._hinted = False
        self._lock = threading.Lock()

    def adopt(self, other: Generations) -> None:
        """Take over the settings of another; what peers told of themselves stays."""
        self._default, self._guess, self._cure, self._rules = other._default, other._guess, other._cure, other._rules
        self._hinted = False

    def introduced(self, peer: str, profile: Profile | None = None, link: PeerAddress = _NOWHERE) -> None:
        """The peer asked for the protocol's version, as clients of 4.0 do, and some of 3.12."""
        asked = "it asked for the protocol's version"
        if profile is Profile.YARP3:
            reason = f"{asked}, and is of YARP 3, of which only 3.12 does"
            self._remember(link, GenerationDecision(peer, Generation.YARP_3_12, reason))
        else:
            self._remember(link, GenerationDecision(peer, Generation.YARP_4, f"{asked}, as clients of 4.0 do"))

    def recognised(self, peer: str, profile: Profile, link: PeerAddress = _NOWHERE) -> None:
        """The peer wrote bytes that only one profile explains: that outweighs all else, also an introduction.

        (Clients of services of one's own may introduce themselves in 3.12 too.)
        """
        if profile is not self.of(peer, link=link).generation.profile:
            self._remember(link, self._by_bytes(peer, profile))

    def called(self, peer: str, method: str, since: Generation, link: PeerAddress = _NOWHERE) -> None:
        """The peer, of YARP 3, called a method that releases before ``since`` lack: a guess is none any more."""
        if not self.of(peer, link=link).sure:
            self._remember(link, GenerationDecision(peer, since, f"it called {method}, which came with {since.value}"))

    def of(self, peer: str, profile: Profile | None = None, link: PeerAddress = _NOWHERE) -> GenerationDecision:
        """The generation for this peer. A known profile outweighs the rules, even where it never called."""
        told = self._told.get((peer, link))
        if told is not None:
            return told
        decision = self._ruled(peer)
        return decision if profile in (None, decision.generation.profile) else self._by_bytes(peer, profile)

    def _ruled(self, peer: str) -> GenerationDecision:
        for pattern, generation in self._rules:
            if fnmatchcase(peer, pattern):
                return GenerationDecision(peer, generation, f"the rule for {pattern} says so")
        if self._default is not None:
            return GenerationDecision(peer, self._default, "its name server's generation")
        return self._guessed(peer, self._guess, "a guess: nothing that it sent tells its release")

    def _by_bytes(self, peer: str, profile: Profile | None) -> GenerationDecision:
        reason = f"its bytes are YARP {'4' if profile is Profile.YARP4 else '3'}'s"
        if profile is Profile.YARP4:
            return GenerationDecision(peer, Generation.YARP_4, reason)
        if self._default not in (None, Generation.YARP_4):
            return GenerationDecision(peer, self._default, reason)
        return self._guessed(peer, Generation.YARP_3_12, f"{reason}; which release of it is a guess")

    def _guessed(self, peer: str, generation: Generation, reason: str) -> GenerationDecision:
        return GenerationDecision(peer, generation, reason, self._cure.format(peer=peer))

    def forget(self, peer: str, link: PeerAddress = _NOWHERE) -> None:
        """The peer's connection came or is gone; the next one may be another release's."""
        with self._lock:
            self._told.pop((peer, link), None)

    def hint(self, decision: GenerationDecision) -> str:
        """The cure of a guess, the first time that one is made; else "": one line in the log is enough."""
        if decision.sure or self._hinted:
            return ""
        self._hinted = True
        return decision.cure

    def explain(self) -> list[GenerationDecision]:
        """Every peer that told of itself, the longest known first."""
        with self._lock:
            return list(self._told.values())

    def _remember(self, link: PeerAddress, decision: GenerationDecision) -> None:
        with self._lock:
            self._told[decision.peer, link] = decision
            while len(self._told) > MOST_PEERS:
                del self._told[next(iter(self._told))]
