"""How a goal gets on, as the gateway's clients are told."""

from __future__ import annotations

from typing import NamedTuple

from navigation.gateway.drive import Drive
from navigation.gateway.link import Link
from navigation.status import Fault, State


class Standing(NamedTuple):
    """A state, and why: in words, and as a number (`navigation.status.Fault` or the planner's own)."""

    state: State
    reason: str = ""
    code: int = 0


def of_drive(drive: Drive, link: Link) -> Standing:
    """How a client's drive gets on."""
    below = drive.below
    if drive.stopping:
        return Standing(State.MOVING, f"stopping: {drive.stopping}")
    if drive.paused:
        return Standing(State.PAUSED, f"{link.planner} is stopping" if below else "")
    if drive.waiting_until is not None:
        return Standing(State.ERROR, f"the planner {link.planner} is not there; it is waited for", Fault.NO_NAVIGATOR)
    if below is None:
        return Standing(State.MOVING)  # it ended without a reason, which is being looked for
    if not below.accepted:
        return Standing(State.PREPARING)
    state, why = link.told(below.id) or (State.MOVING, "")
    if state.ended:
        return Standing(State.MOVING, "", link.code(below.id))  # how it ended comes as the goal's result
    return Standing(State.MOVING if state is State.PAUSED else state, why, link.code(below.id))


def of_others(link: Link, goal: bytes) -> Standing:
    """How a goal gets on that the planner was given itself."""
    state, why = link.told(goal) or (State.MOVING, "")
    return Standing(state, why or _itself(link), link.code(goal))


def of_ended(link: Link, goal: bytes, state: State, why: str) -> Standing:
    """How such a goal ended."""
    told = link.told(goal)
    return Standing(state, why or (told[1] if told else "") or _itself(link), link.code(goal))


def _itself(link: Link) -> str:
    return f"a goal that {link.planner} was given itself"
