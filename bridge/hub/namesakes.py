"""Detects and distinguishes daemons on one hub that have the same name, and therefore the same keys."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace

import zenoh

from bridge.hub.control import WHO, WorkerAnswer, ask
from bridge.hub.daemons import DaemonIdentity
from bridge.hub.links import MEMBERS

_log = logging.getLogger(__name__)

_EVERY = 10.0
_ANSWER_SECONDS = 1.0
_WHO_SECONDS = 0.5
"""Time limit for the workers' identities; short, because a worker that hangs must not delay the router's heartbeat."""

Routers = dict[str, frozenset[str]]
"""The sessions that are linked to each router, by the router's id."""


class Namesakes:
    """Searches the hub for other daemons with this daemon's name.

    Attributes:
        warning: names the other daemons, and how to resolve the conflict; "" if there are none.
    """

    def __init__(self, session: zenoh.Session, domain: int, daemon: str, own: DaemonIdentity | None) -> None:
        self._session, self._domain, self._daemon, self._own = session, domain, daemon, own
        self._due = 0.0
        self.warning = ""

    def check(self) -> None:
        """Search at most every 10 s, and log changes."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + _EVERY
        others = sorted(self._others())
        warning = namesake_warning(", ".join(others), self._daemon) if others else ""
        if warning and warning != self.warning:
            _log.warning("%s", warning)
        elif self.warning and not warning:
            _log.info("no other daemon on the hub is named %r now", self._daemon)
        self.warning = warning

    def _others(self) -> set[str]:
        """Return the machines of other routers with this daemon name, and the places of namesakes at this router."""
        own = str(self._session.zid())
        asked = ask(self._session, self._domain, MEMBERS, {}, self._daemon, "router", _ANSWER_SECONDS)
        answers = [answer for answer in asked if self._is_here(answer.value)]
        values = [answer.value for answer in answers]
        machines = {str(value.get("zid")): str(value.get("machine", "")) for value in values}
        others = {f"{machine or 'a machine'} (router {zid[:8]})" for zid, machine in machines.items() if zid != own}
        routers = _routers(answers).get(self._daemon, {})
        theirs = {session for zid, sessions in routers.items() if zid != own for session in sessions}
        workers = ask(self._session, self._domain, "status", WHO, self._daemon, "*", _WHO_SECONDS)
        local = {worker.identity for worker in workers if worker.identity and worker.session not in theirs}
        return others | {identity.place for identity in local if self._own and identity.instance != self._own.instance}

    def _is_here(self, value: object) -> bool:
        """Return whether a router's answer is from this domain; routers answer the queries of all domains."""
        return isinstance(value, dict) and value.get("domain", self._domain) == self._domain


def namesake_warning(others: str, daemon: str) -> str:
    """Return the warning that ``others`` are daemons with the same name."""
    return (
        f"another daemon on this hub is also named {daemon!r} ({others}): commands for one reach both; set another"
        " 'name' in one of the configurations"
    )


class DaemonNames:
    """Gives daemons on a hub that have the same name distinct names in their answers.

    The own daemon keeps its name. The name of another daemon is extended by the id of its router or, at the same
    router, by its place (`DaemonIdentity`).

    Args:
        status: answers to ``status``, at least those of the routers.
        own_session: a session at this daemon's router.
        own: instance ids that this daemon may have, most likely first.
    """

    def __init__(self, status: Sequence[WorkerAnswer], own_session: str, own: Sequence[str] = ()) -> None:
        self._routers, self._session, self._candidates = _routers(status), own_session, own
        self._here: dict[str, dict[str, DaemonIdentity]] = {}
        self._add(status)

    def apply(self, answers: Sequence[WorkerAnswer]) -> list[WorkerAnswer]:
        """Return the answers with distinct daemon names."""
        self._add(answers)
        return [self._distinguish(answer) for answer in answers]

    def several(self) -> dict[str, list[str]]:
        """Return the names that several daemons share, each with the locations of these daemons."""
        places: dict[str, set[str]] = {}
        for name in self._routers.keys() | self._here.keys():
            routers, here = self._routers.get(name, {}), self._here.get(name, {})
            places[name] = {f"router {zid[:8]}" for zid in routers if len(routers) > 1}
            places[name] |= {identity.place for identity in here.values() if len(here) > 1}
        return {name: sorted(shared) for name, shared in sorted(places.items()) if shared}

    def _add(self, answers: Iterable[WorkerAnswer]) -> None:
        """Note the daemons that the router's id does not already distinguish."""
        for answer in answers:
            if answer.identity is not None and not self._router(answer):
                self._here.setdefault(answer.daemon, {})[answer.identity.instance] = answer.identity

    def _router(self, answer: WorkerAnswer) -> str:
        """Return the router of the answer's daemon if several have its name and it is not this daemon's, else ""."""
        routers = self._routers.get(answer.daemon, {})
        if len(routers) > 1:
            for zid, sessions in routers.items():
                if answer.session in sessions and self._session not in sessions:
                    return zid
        return ""

    def _distinguish(self, answer: WorkerAnswer) -> WorkerAnswer:
        if zid := self._router(answer):
            return replace(answer, daemon=f"{answer.daemon} (router {zid[:8]})")
        here, identity = self._here.get(answer.daemon, {}), answer.identity
        own = next((instance for instance in self._candidates if instance in here), "")
        if identity is None or identity.instance == own or len(here) < 2:
            return answer
        return replace(answer, daemon=f"{answer.daemon} ({identity.place})")


def own_answers(answers: Sequence[WorkerAnswer], own_session: str, own: DaemonIdentity | None) -> list[WorkerAnswer]:
    """Return the answers to ``status``, without those of other daemons with this daemon's name."""
    names = DaemonNames(answers, own_session, [own.instance] if own else ())
    return [
        answer
        for answer, named in zip(answers, names.apply(answers), strict=True)
        if answer.daemon == named.daemon
        and (own is None or answer.identity is None or answer.identity.instance == own.instance)
    ]


def _routers(answers: Iterable[WorkerAnswer]) -> dict[str, Routers]:
    """Return the routers by the name of their daemon, from their answers to ``status`` or ``members``."""
    routers: dict[str, Routers] = {}
    for answer in answers:
        if answer.worker == "router" and isinstance(answer.value, dict) and answer.value.get("zid"):
            zid, members = str(answer.value["zid"]), answer.value.get("members")
            sessions = frozenset({zid, *map(str, members if isinstance(members, list) else ())})
            routers.setdefault(answer.daemon, {})[zid] = sessions
    return routers
