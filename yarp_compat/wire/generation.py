"""Chooses the format of replies to each YARP client, out of four generations.

YARP's generated (thrift) services have changed their replies to the same requests three times: first a bool, then an
untagged number, a tagged number, and a list. The first of these sources that applies decides a client's generation:

1. the client's bytes: YARP 4 has its own tags for numbers and asks for the protocol's version, and some methods exist
   only since 3.12;
2. the settings;
3. findings: the YARP library that the client's process has loaded, or how the client reacts to a reply;
4. a guess, with the carrier of the connection as a hint.

After a guess, replies that another release would misread are avoided (`yarp_compat.dev.returnvalue`).
"""

from __future__ import annotations

import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from fnmatch import fnmatchcase
from typing import Any

from yarp_compat.wire.profile import Profile

MOST_PEERS = 4096  # clients whose release is remembered; the oldest entry is dropped first
MOST_HINTS = 100  # clients for which the log names the setting


class Generation(Enum):
    """A format of a call's results; its value is the first release of YARP that writes it."""

    YARP_3_6 = "3.6"  # a bool: the vocab ``[ok]`` or ``[fail]``
    YARP_3_11 = "3.11"  # an int64 without a tag
    YARP_3_12 = "3.12"  # an int32 with its tag
    YARP_4 = "4.0"  # a list of one vocab: ``([ok])``, ``([err1])`` to ``([err7])``

    @property
    def profile(self) -> Profile:
        """The Bottle tags that this generation writes."""
        return Profile.YARP4 if self is Generation.YARP_4 else Profile.YARP3

    @property
    def before_3_12(self) -> bool:
        """Whether this generation is older than 3.12, which also reordered some streams."""
        return self in (Generation.YARP_3_6, Generation.YARP_3_11)

    @classmethod
    def of(cls, version: str) -> Generation:
        """Return the generation of a release of YARP, such as ``3.9.1`` or ``4``; ``3`` means 3.12.

        Raises `ValueError` for a release before 3.6, or a text that is not a release.
        """
        match = re.fullmatch(r"(\d{1,4})(?:\.(\d{1,4}))?(?:\.\d{1,8})?\+?", version.strip())
        release = (int(match[1]), int(match[2] or 0)) if match else (0, 0)
        if match and match[2] is None and release[0] == 3:
            release = (3, 12)
        for generation in reversed(cls):
            first = tuple(map(int, generation.value.split(".")))
            if release >= first:
                return generation
        raise ValueError(
            f"{version!r} is not a supported version of YARP: give one from 3.6 on, such as 3.9, 3.12 or 4.0"
        )

    @classmethod
    def newest(cls, profile: Profile) -> Generation:
        """Return the generation to expect if only the Bottle tags are known."""
        return cls.YARP_4 if profile is Profile.YARP4 else cls.YARP_3_12


PeerAddress = tuple[str, int]  # the client's end of a connection, which distinguishes two clients with one name
_NOWHERE: PeerAddress = ("", 0)


@dataclass(frozen=True, slots=True)
class GenerationDecision:
    """The generation for a client, and the reason; ``cure`` names the setting that replaces a guess, or is empty."""

    peer: str
    generation: Generation
    reason: str
    cure: str = ""

    @property
    def sure(self) -> bool:
        """Whether the generation is more than a guess."""
        return not self.cure

    def as_dict(self) -> dict[str, str]:
        """Return the generation and its reason for a status document; for a guess also the setting that replaces it."""
        document = {"generation": self.generation.value, "generation_why": self.reason}
        return document if self.sure else {**document, "generation_cure": self.cure}


@dataclass(frozen=True, slots=True)
class ReleaseFinding:
    """An observation of a client.

    ``sure``: only this generation explains the observation; ``overrides``: the client itself disclosed its generation,
    so settings are ignored.
    """

    generation: Generation
    reason: str
    sure: bool = True
    overrides: bool = False


@dataclass(slots=True)
class Trial:
    """A reply in a chosen generation, to find out whether a client can read it (`yarp_compat.dev.release_trial`)."""

    generation: Generation
    answered: bool = False  # whether the reply was sent, with values


_OF_ONE_DEVICE = re.compile(r"/(?:(?:navigation|locations|localization|user_commands)/rpc|mapClient_rpc|rpc:o|data:i)")


def device_of(peer: str) -> str:
    """Return the common prefix of a network wrapper client's ports (its parameter ``local``); else the name itself."""
    match = _OF_ONE_DEVICE.search(peer)
    return peer[: match.start()] if match and match.end() == len(peer) and peer.startswith("/") else peer


class Findings:
    """Observations of clients, by device (all ports of a device belong to one process). Servers may share them."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, PeerAddress], tuple[str, ReleaseFinding]] = {}  # with the port that disclosed it
        self._trials: dict[str, Trial] = {}
        self._processes: dict[str, str] = {}  # by device
        self._lock = threading.Lock()

    def get(self, peer: str, link: PeerAddress = _NOWHERE) -> ReleaseFinding | None:
        """Return the finding on a client; if it is missing or not sure, prefer a sure one of its process."""
        with self._lock:
            known = self._known.get(_key(peer, link))
            if known is not None and known[1].sure:
                return known[1]
            process = self._processes.get(device_of(peer))
            for device, other in self._processes.items() if process is not None else ():
                _, finding = self._known.get((device, _NOWHERE), ("", None))
                if other == process and finding is not None and finding.sure:
                    return replace(finding, reason=f"its process also has {device}, and {finding.reason}")
            return None if known is None else known[1]

    def join(self, peer: str, process: str) -> None:
        """Record the process that a client belongs to."""
        with self._lock:
            self._processes[device_of(peer)] = process
            _limit(self._processes)

    def add(self, peer: str, finding: ReleaseFinding, link: PeerAddress = _NOWHERE) -> None:
        """Record a finding; a guess never replaces a sure one."""
        key = _key(peer, link)
        with self._lock:
            known = self._known.get(key)
            if finding.sure or known is None or not known[1].sure:
                self._known[key] = peer, finding
                _limit(self._known)

    def begin(self, device: str, trial: Trial) -> Trial | None:
        """Begin a trial of a device; return None while another one runs."""
        with self._lock:
            return trial if self._trials.setdefault(device, trial) is trial else None

    def trial_of(self, peer: str) -> Trial | None:
        """Return the running trial of a client, or None."""
        return self._trials.get(device_of(peer))

    def end(self, device: str) -> None:
        """End the trial of a device."""
        with self._lock:
            self._trials.pop(device, None)

    def drop(self, peer: str, link: PeerAddress = _NOWHERE) -> None:
        """Discard this port's finding; findings from other ports of the device stay."""
        key = _key(peer, link)
        with self._lock:
            if key in self._known and self._known[key][0] == peer:
                del self._known[key]
            self._processes.pop(device_of(peer), None)


def _key(peer: str, link: PeerAddress) -> tuple[str, PeerAddress]:
    """Return the key of a client: names of ports are unique, other names are not."""
    return (device_of(peer), _NOWHERE) if peer.startswith("/") else (peer, link)


class Generations:
    """The generations of all clients, by connection, with the facts that the clients disclosed."""

    def __init__(
        self,
        default: Generation | None = None,  # for all clients on this name server, if configured
        # patterns of port names (``/cer/*``) with their generations; the first match counts
        rules: Sequence[tuple[str, Generation]] = (),
        *,
        guess: Generation = Generation.YARP_3_12,  # for clients without any of the above
        cure: str = "give the server the Generations of its peers",  # the setting; ``{peer}`` stands for the client
        findings: Findings | None = None,
    ) -> None:
        self._default, self._guess, self._cure = default, guess, cure
        self._rules = tuple(rules)
        self.findings = Findings() if findings is None else findings
        self._disclosed: dict[tuple[str, PeerAddress], GenerationDecision] = {}
        self._inspected: set[tuple[str, PeerAddress]] = set()
        self._hinted: set[str] = set()
        self._lock = threading.Lock()

    def adopt(self, other: Generations) -> None:
        """Adopt the settings of another instance; keep what clients disclosed."""
        self._default, self._guess, self._cure, self._rules = other._default, other._guess, other._cure, other._rules
        self._hinted = set()

    def introduced(self, peer: str, profile: Profile | None = None, link: PeerAddress = _NOWHERE) -> None:
        """Record that the client asked for the protocol's version, as clients of 4.0 do, and some of 3.12."""
        request = "it asked for the protocol's version"
        if profile is Profile.YARP3:
            reason = f"{request} in YARP 3's format, as only 3.12 does"
            self._remember(link, GenerationDecision(peer, Generation.YARP_3_12, reason))
        else:
            self._remember(link, GenerationDecision(peer, Generation.YARP_4, f"{request}, as clients of 4.0 do"))

    def recognized(self, peer: str, profile: Profile, link: PeerAddress = _NOWHERE) -> None:
        """Record that the client writes bytes that only this profile has; they override what `introduced` recorded.

        (In 3.12, clients of custom services may ask for the protocol's version too.)
        """
        if profile is not self.of(peer, link=link).generation.profile:
            self._remember(link, self._by_bytes(peer, profile))

    def called(self, peer: str, method: str, since: Generation, link: PeerAddress = _NOWHERE) -> None:
        """Record that a client of YARP 3 called a method that exists only since ``since``."""
        if not self.of(peer, link=link).sure:
            self._remember(
                link, GenerationDecision(peer, since, f"it called {method}, which exists since {since.value}")
            )

    def of(self, peer: str, profile: Profile | None = None, link: PeerAddress = _NOWHERE) -> GenerationDecision:
        """Return a client's generation. A known profile overrides the rules, even before the client's first call."""
        disclosed = self._disclosed.get((peer, link))
        finding = self.findings.get(peer, link)
        if disclosed is None and finding is not None and finding.overrides:
            fits = profile in (None, finding.generation.profile)
            generation = finding.generation if profile is None or fits else Generation.newest(profile)
            return GenerationDecision(peer, generation, finding.reason)
        decision = disclosed or self._ruled(peer)
        if disclosed is None and profile not in (None, decision.generation.profile):
            decision = self._by_bytes(peer, profile)
        if decision.sure or finding is None:
            return decision
        known = decision.generation.profile if disclosed is not None else profile
        if known not in (None, finding.generation.profile):
            return decision
        return GenerationDecision(peer, finding.generation, finding.reason, "" if finding.sure else decision.cure)

    def _ruled(self, peer: str) -> GenerationDecision:
        for pattern, generation in self._rules:
            if fnmatchcase(peer, pattern):
                return GenerationDecision(peer, generation, f"set by the rule for {pattern}")
        if self._default is not None:
            return GenerationDecision(peer, self._default, "its name server's generation")
        return self._guessed(peer, self._guess, "a guess: several releases send such requests")

    def _by_bytes(self, peer: str, profile: Profile | None) -> GenerationDecision:
        reason = f"its bytes are YARP {'4' if profile is Profile.YARP4 else '3'}'s"
        if profile is Profile.YARP4:
            return GenerationDecision(peer, Generation.YARP_4, reason)
        if self._default not in (None, Generation.YARP_4):
            return GenerationDecision(peer, self._default, reason)
        return self._guessed(peer, Generation.YARP_3_12, f"{reason}; the release of YARP 3 is a guess")

    def _guessed(self, peer: str, generation: Generation, reason: str) -> GenerationDecision:
        return GenerationDecision(peer, generation, reason, self._cure.format(peer=peer))

    def connected(self, peer: str, carrier: str, link: PeerAddress = _NOWHERE) -> None:
        """Record a new connection: discard an earlier client's facts, and use the carrier as a hint.

        By default, ``map2D_nwc_yarp`` connects over tcp up to 3.9, later over fast_tcp (``map2D_nwc_yarp_params.md``).
        """
        self.forget(peer, link)
        if carrier == "tcp" and peer.endswith("/mapClient_rpc"):
            reason = "a guess: map2D_nwc_yarp connects by tcp up to 3.9, later by fast_tcp"
            self.findings.add(peer, ReleaseFinding(Generation.YARP_3_6, reason, sure=False), link)

    def inspects(self, peer: str, profile: Profile | None = None, link: PeerAddress = _NOWHERE) -> bool:
        """Return whether to inspect the client's process: once per connection, if its generation is only a guess."""
        if self.of(peer, profile, link).sure:
            return False
        with self._lock:
            is_new = (peer, link) not in self._inspected
            self._inspected.add((peer, link))
        return is_new

    def forget(self, peer: str, link: PeerAddress = _NOWHERE) -> None:
        """Discard the facts about a client whose connection began or ended: the next may have another release."""
        with self._lock:
            self._disclosed.pop((peer, link), None)
            self._inspected.discard((peer, link))
        self.findings.drop(peer, link)

    def hint(self, decision: GenerationDecision) -> str:
        """Return the cure of a guess for the log, once for each client; else ""."""
        if decision.sure or decision.peer in self._hinted or len(self._hinted) >= MOST_HINTS:
            return ""
        self._hinted.add(decision.peer)
        return decision.cure

    def explain(self) -> list[GenerationDecision]:
        """Return the decisions on all clients that disclosed their generation, the oldest first."""
        with self._lock:
            return list(self._disclosed.values())

    def _remember(self, link: PeerAddress, decision: GenerationDecision) -> None:
        with self._lock:
            self._disclosed[decision.peer, link] = decision
            _limit(self._disclosed)
        if decision.sure:  # for the other ports of the same device
            self.findings.add(decision.peer, ReleaseFinding(decision.generation, decision.reason, overrides=True), link)


def _limit(entries: dict[Any, Any]) -> None:
    while len(entries) > MOST_PEERS:
        del entries[next(iter(entries))]
