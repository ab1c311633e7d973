"""Status documents of daemons that have the same name on several machines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bridge.cli.documents import texts
from bridge.hub.control import WorkerAnswer

Routers = dict[str, frozenset[str]]
"""The sessions that are linked with each router, by the router's id."""


def distinct(answers: Sequence[WorkerAnswer], own_session: str) -> list[WorkerAnswer]:
    """Return answers to ``status`` in which no two machines' daemons have the same name.

    The daemon of the machine with ``own_session`` keeps its name; others have their router's id in addition.
    """
    routers: dict[str, Routers] = {}
    for answer in answers:
        if answer.worker == "router" and isinstance(answer.value, dict) and answer.value.get("zid"):
            zid = str(answer.value["zid"])
            sessions = frozenset({zid, *texts(answer.value.get("members"))})
            routers.setdefault(answer.daemon, {})[zid] = sessions
    return [_distinct(answer, routers.get(answer.daemon, {}), own_session) for answer in answers]


def _distinct(answer: WorkerAnswer, routers: Routers, own_session: str) -> WorkerAnswer:
    for zid, sessions in routers.items():
        if len(routers) > 1 and answer.session in sessions and own_session not in sessions:
            return replace(answer, daemon=f"{answer.daemon} (router {zid[:8]})")
    return answer
