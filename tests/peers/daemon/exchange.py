"""A lossless exchange, without duplicates, between a side's program and one or two hubs, through two daemons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from tests.contract.hubside import HubSide
from tests.support.wait import until

STRING = "std_msgs/String"


def exchange(
    program: Any, out: int, received: int, far: Sequence[HubSide], settled: Callable[[], bool] = lambda: True
) -> list[int]:
    """Publish 20 messages from each participant on ``/both``; each arrives once everywhere, and none is looped back.

    ``settled`` returns whether the daemons' ports are final.

    Returns:
        the hubs' publishers.
    """
    at_far = [end.subscribe("/both", STRING) for end in far]
    from_far = [end.advertise("/both", STRING) for end in far]
    ends = list(zip(far, from_far, at_far, strict=True))
    until_all_receive(program, out, received, ends)
    until(settled, "the daemons' ports are final")
    until_all_receive(program, out, received, ends)
    for number in range(20):
        program.publish(out, {"data": f"program {number}"})
        for which, (end, sender, _) in enumerate(ends):
            end.publish(sender, {"data": f"far {which} {number}"})
    from_program = [f"program {n}" for n in range(20)]
    from_hubs = [f"far {which} {n}" for which in range(len(far)) for n in range(20)]
    try:
        until(lambda: set(from_hubs) <= _texts(program, received), "the program receives everything")
        for end, _, subscription in ends:
            until(lambda e=end, s=subscription: set(from_program) <= _texts(e, s), "a hub receives everything")
    except AssertionError as error:
        error.add_note(f"at the program: {sorted(m['data'] for m in program.wait(received, 1, 0.1))}")
        for end, _, subscription in ends:
            error.add_note(f"at a hub: {sorted(_texts(end, subscription))}; its bridges: {_routes(end)}")
        raise
    got = sorted(m["data"] for m in program.wait(received, 10_000, 0.5) if "probe" not in m["data"])
    # the program also receives its own messages
    assert got == sorted(from_hubs + from_program)
    for end, _, subscription in ends:
        got = sorted(m["data"] for m in end.wait(subscription, 10_000, 0.2) if m["data"].startswith("program"))
        assert got == sorted(from_program)
    return from_far


def _texts(end: Any, subscription: int) -> set[str]:
    return {m["data"] for m in end.wait(subscription, 1, 0.1)}


def _routes(end: HubSide) -> list[Any]:
    """Return the bridges' status on a hub: routes and dropped messages."""
    statuses = [answer.value for answer in end.hub.ask("status", {}) if isinstance(answer.value, dict)]
    return [{key: status.get(key) for key in ("worker", "state", "lease", "routes")} for status in statuses]


def until_all_receive(program: Any, out: int, received: int, far: list[tuple[HubSide, int, int]]) -> None:
    """Wait until a new probe from the program arrives at every hub, and one from every hub at the program."""
    mark = f"probe {len(program.wait(received, 0))}"

    missing: set[str] = set()

    def probes_arrived() -> bool:
        missing.clear()
        program.publish(out, {"data": mark})
        for which, (end, sender, subscription) in enumerate(far):
            end.publish(sender, {"data": f"{mark} {which}"})
            if mark not in _texts(end, subscription):
                missing.add(f"the program's at hub {which}")
        at_program = _texts(program, received)
        missing.update(
            f"hub {which}'s at the program" for which in range(len(far)) if f"{mark} {which}" not in at_program
        )
        return not missing

    try:
        until(probes_arrived, "probes arrive", 30)
    except AssertionError as error:
        error.add_note(f"missing: {sorted(missing)}")
        raise
