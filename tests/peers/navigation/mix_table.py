"""One table of clients on every side with planners on every side, through one daemon's gateway.

``python -m tests.peers.navigation.mix_table [--json FILE]`` (`make mix`) prints the table, and `tests.interop.test_mix`
checks it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation import mix_faults
from tests.peers.navigation.gateway import pose
from tests.peers.navigation.mix import IDS, MOVE_BASE, NAV2, OURS, OWN, Mix
from tests.peers.navigation.mix_clients import ROS1, ROS2, SECONDS, YARP, ZENOH, Client, RosClient
from tests.peers.navigation.mix_faults import FAULTS, Watch
from tests.support.wait import until

NEAR, FAR, NOWHERE = 1.0, 40.0, 999.0
"""Goals in meters along x: reached soon, reached late, unreachable."""

PARTS = ("goto", "feedback", "pause", "resume", "cancel", "abort")
WHY = {OURS: "is outside the map", MOVE_BASE: "Failed to find a valid plan.", NAV2: "no path to the goal"}
"""Each planner's reason for an unreachable goal."""

ONE_EACH = {
    "planner dies": (YARP,),
    "planner hangs": (ROS2,),
    "ros1 worker dies": (ZENOH,),
    "modules die": (YARP,),
    "master dies": (ROS1,),
    "ros1 and modules die": (ROS1,),
    "bt_navigator gives up": (ROS2,),
    "bt_navigator dies": (YARP,),
}
"""Clients that the test uses for each fault; ``make mix`` uses more."""


@dataclass(frozen=True)
class Cell:
    """One part of a client's use of one planner.

    Attributes:
        seen: ``yes``, ``own`` (the client is the planner's own), or what failed.
        seconds: duration of the part; for a fault, the longest time that the robot moved while reported to stand.
        note: what clients received during a fault.
    """

    planner: str
    client: str
    part: str
    seen: str
    seconds: float
    note: str = ""

    @property
    def good(self) -> bool:
        """Return whether the result is as expected."""
        direct = (self.planner, self.client) in OWN and self.part in ("pause", "resume", *FAULTS)
        return self.seen == ("own" if direct else "yes")


class Trials:
    """The tests with a `Mix`."""

    def __init__(self, mix: Mix) -> None:
        self.mix = mix

    def cells(self, planner: str, name: str) -> Iterator[Cell]:
        """Test all parts with one client."""
        client = self.mix.clients[name]
        direct = (planner, name) in OWN
        tries: dict[str, Callable[[], str]] = {
            "goto": lambda: self._goto(client),
            "feedback": lambda: self._feedback(client),
            "pause": lambda: self._pause(client, own=direct),
            "resume": lambda: self._resume(client, own=direct),
            "cancel": lambda: self._cancel(client),
            "abort": lambda: self._abort(client, planner, own=direct),
        }
        for part in PARTS:
            yield _tried(planner, name, part, tries[part])

    def others(self, planner: str) -> Iterator[Cell]:
        """Test goals on topics, goals in an unknown frame, and programs that are killed while the robot drives."""
        tries: dict[str, list[tuple[str, str, Callable[[str, Client], str]]]] = {
            OURS: [
                ("a goal on /move_base_simple/goal", ROS1, partial(self._publish, "/move_base_simple/goal")),
                ("a goal on /goal_pose", ROS2, partial(self._publish, "/goal_pose")),
            ],
            MOVE_BASE: [
                ("an unknown frame", ROS2, self._unknown_frame),
                ("the planner's own goal, stopped by YARP", ROS1, self._stop_direct),
                ("planner killed, and back", ROS2, self._kill_planner),
            ],
            NAV2: [("client killed", ROS1, self._kill_client)],
        }
        for part, name, attempt in tries.get(planner, []):
            yield _tried(planner, name, part, partial(attempt, planner, self.mix.clients[name]))

    def faults(self, planner: str, *, every: bool) -> Iterator[Cell]:
        """Test each fault between clients and a planner, with several clients if ``every``, else with one."""
        for part, fault in FAULTS.items():
            if fault.planner != planner:
                continue
            for name in fault.clients if every else ONE_EACH[part]:
                direct, watches = (planner, name) in OWN, list[Watch]()
                cell = _tried(
                    planner, name, part, partial(mix_faults.attempt, self.mix, fault, name, watches, own=direct)
                )
                if watches:
                    cell = replace(cell, note=str(watches[0]), seconds=round(watches[0].untrue, 2))
                if not cell.good:
                    self.mix.recover()
                yield cell

    def _publish(self, topic: str, _planner: str, client: Client) -> str:
        assert isinstance(client, RosClient)
        out = client.peer.advertise(topic, "geometry_msgs/PoseStamped")

        def moves() -> bool:
            client.peer.publish(out, pose(FAR))
            return self.mix.state() == "moving"

        until(moves, "the status is moving", SECONDS, 0.2)
        client.peer.drop(out)

        def stands() -> bool:
            with contextlib.suppress(AssertionError):  # no "ok" if a goal arrives after the stop
                self.mix.clients[YARP].cancel()
            return not self.mix.driving() and self.mix.state() == "idle"

        until(stands, "the robot was stopped", SECONDS, 0.3)  # repeated: a published goal may arrive after a stop
        return "yes"

    def _unknown_frame(self, _planner: str, client: Client) -> str:
        assert isinstance(client, RosClient)
        client.goto(NEAR, frame="nowhere")  # move_base itself would keep this goal forever
        self._ends(client, "aborted", "aborted")
        return "yes"

    def _stop_direct(self, _planner: str, client: Client) -> str:
        client.goto(FAR)
        until(lambda: self.mix.state() == "moving", "the status is moving", SECONDS)
        self.mix.clients[YARP].cancel()
        self._ends(client, "canceled", "idle")
        return "yes"

    def _kill_planner(self, planner: str, client: Client) -> str:
        mix = self.mix
        client.goto(FAR)
        until(client.progress, "progress is reported", SECONDS)
        mix.planner.stop(0)
        until(lambda: "not available; waiting for it" in mix.status()[1], "the status gives the reason", SECONDS)
        assert mix.state() in ("moving", "preparing_before_move"), (
            mix.state()
        )  # the goal has not ended, and continues by itself
        assert client.end() == "", f"the client's goal ended: {client.end()}"
        mix.start(planner)
        before = client.progress()
        until(lambda: client.progress() > before, "the drive continues", SECONDS)
        return self._cancel(client)

    def _kill_client(self, _planner: str, client: Client) -> str:
        client.goto(FAR)
        until(client.progress, "progress is reported", SECONDS)
        until(self.mix.driving, "the planner lists the goal", SECONDS)
        assert isinstance(client, RosClient)
        client.peer.stop(0)
        other = self.mix.clients[YARP]
        assert self.mix.driving(), "the goal ended with its client, unlike without a bridge"
        other.cancel()
        self._ends(other, "canceled", "idle")
        return "yes"

    def _goto(self, client: Client) -> str:
        client.goto(NEAR)
        self._ends(client, "succeeded", "goal_reached")
        return "yes"

    def _feedback(self, client: Client) -> str:
        client.goto(FAR)
        until(lambda: client.progress() >= 3, "progress is reported", SECONDS)
        until(lambda: self.mix.state() == "moving", "the status is moving", SECONDS)
        return "yes"

    def _ask(self, client: Client, word: str) -> bool:
        answer = client.ask(word)
        return until(answer, f"{word} is answered", SECONDS) is not None and (answer() or (0.0, "?"))[1] == ""

    def _pause(self, client: Client, *, own: bool) -> str:
        if own:
            assert not self._ask(client, "pause"), "a goal of the planner's own client was paused"
            return "own"
        # repeated, because a pause that a busy machine does not confirm within 2.5 s fails, and continues
        until(lambda: self._ask(client, "pause"), "the pause is confirmed", SECONDS)
        until(lambda: not self.mix.driving() and self.mix.state() == "paused", "the drive is paused", SECONDS)
        assert client.end() == "", f"the client's goal ended in the pause: {client.end()}"
        return "yes"

    def _resume(self, client: Client, *, own: bool) -> str:
        if own:
            assert not self._ask(client, "resume"), "a goal was resumed without a pause"
            return "own"
        goals, progress = set(self.mix.listed), client.progress()
        assert self._ask(client, "resume"), "the drive was not resumed"
        until(lambda: self.mix.driving() - goals, "the planner has a new goal", SECONDS)
        until(lambda: client.progress() > progress, "progress is reported again", SECONDS)
        return "yes"

    def _cancel(self, client: Client) -> str:
        client.cancel()
        self._ends(client, "canceled", "idle")
        return "yes"

    def _abort(self, client: Client, planner: str, *, own: bool) -> str:
        reason = WHY[planner]
        client.goto(NOWHERE)
        self._ends(client, "aborted", "aborted")
        received, status = client.why(), self.mix.status()[1]
        no_text = received is None or (own and planner == NAV2)  # Nav2 itself sends only an error code
        assert no_text or reason in (received or ""), f"the client received {received!r}, not {reason!r}"
        assert own or reason in status, f"/navigation/status gives {status!r}, not {reason!r}"
        return "yes"

    def _ends(self, client: Client, end: str, state: str) -> None:
        until(client.end, "the client's goal ends", SECONDS)
        assert client.end() == end, f"{client.end()}, not {end}: {self.mix.status()[1]}"
        until(lambda: not self.mix.driving(), "the planner has no goal", SECONDS)
        until(lambda: self.mix.state() == state, f"the status is {state}", SECONDS)


def _tried(planner: str, client: str, part: str, attempt: Callable[[], str]) -> Cell:
    began = time.monotonic()
    try:
        seen = attempt()
    except AssertionError as err:
        seen = f"failed: {err}"
    return Cell(planner, client, part, seen, round(time.monotonic() - began, 2))


def table(deployment: Deployment, *, every: bool = False) -> Iterator[Cell]:
    """Start the daemon, and test every client with every planner; with ``every``, faults with more clients."""
    mix = Mix(deployment)
    trials = Trials(mix)
    for planner in IDS:
        mix.start(planner)
        mix.choose(planner)
        for client in mix.clients:
            yield from trials.cells(planner, client)
        yield from trials.faults(planner, every=every)
        yield from trials.others(planner)
        mix.end()


def text(cells: list[Cell]) -> str:
    """Return the tables: clients by planners, and faults by clients."""
    clients = (YARP, ROS1, ROS2, ZENOH)
    seen = {(cell.planner, cell.client, cell.part): cell for cell in cells}
    parts = [("planner", "client", *PARTS)]
    for planner in IDS:
        for client in clients:
            row = [seen.get((planner, client, part)) for part in PARTS]
            parts.append((planner, client, *(_mark(cell) if cell else "?" for cell in row)))
    faults = [("planner", "fault", *clients)]
    for part, fault in FAULTS.items():
        row = [seen.get((fault.planner, client, part)) for client in clients]
        faults.append((fault.planner, part, *(_mark(cell, fault=True) if cell else "-" for cell in row)))
    rows = [*_columns(parts), "", *_columns(faults), ""]
    rows += [f"{c.part} ({c.planner}; {c.client}): {_mark(c)}" for c in cells if c.part not in (*PARTS, *FAULTS)]
    rows += [f"{c.part} ({c.client}): {c.note}" for c in cells if c.note]
    rows += [
        "own: the planner's own client, whose protocol has no pause; -: not tested",
        "seconds of a fault: the longest time that the robot still moved after it was reported to stand",
    ]
    return "\n".join([*rows, *(f"{c.planner}, {c.client}, {c.part}: {c.seen}" for c in cells if not c.good)])


def _columns(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _mark(cell: Cell, *, fault: bool = False) -> str:
    mark = cell.seen if cell.good else "FAILED"
    return f"{mark} {cell.seconds:.1f} s" if fault or mark == "yes" else mark


def main() -> int:
    """Print the table; return 1 if any result is not as expected."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the table to this file")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, Deployment(Path(folder)) as deployment:
        cells = list(table(deployment, every=True))
    print(text(cells))
    if args.json:
        args.json.write_text(json.dumps([{**asdict(cell), "good": cell.good} for cell in cells], indent=2) + "\n")
    return int(not all(cell.good for cell in cells))


if __name__ == "__main__":
    sys.exit(main())
