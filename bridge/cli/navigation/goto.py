"""``midspan goto``: drive to a place or a pose, with progress."""

from __future__ import annotations

import argparse
import base64
import contextlib
import math
import sys
import time
from collections import deque
from typing import Any

from bridge.cli.arguments import add_hub_arguments
from bridge.cli.client import CliClient, open_client
from bridge.cli.graph.goal import STATES, SUCCEEDED, FollowedGoal, Interrupt
from bridge.cli.messages import Types
from bridge.cli.navigation.gateway import (
    STATUS,
    STATUS_TOPIC,
    LatestMessage,
    check_daemon,
    gateway_caller,
    no_answer,
    place_text,
    state_text,
)
from bridge.cli.output import CliError, clean, print_json
from navigation.constraints import Constraints
from navigation.nav2_errors import reason_text

ACTION = "/navigate_to_pose"
_PERIOD, _PERIOD_SCREEN = 5.0, 0.5
_ASK_SECONDS = 10.0
_MOST_NEWS = 100
_TERMINATED = (129, 143)
"""Exit codes for SIGHUP and SIGTERM."""


def register(parser: argparse.ArgumentParser) -> None:
    """Describe the verb and its arguments."""
    parser.description = (
        "Drives to a location or an area of the store, or to a pose on the map, with the chosen planner, and shows the"
        " progress. Ctrl-C, SIGTERM and SIGHUP cancel the goal. Exit code 0: arrived, 1: not arrived, 130, 143 and 129:"
        " canceled by these signals."
    )
    parser.epilog = "Examples: midspan goto kitchen; midspan goto 1.0 -2.0 90; midspan goto -1.5 2"
    parser.add_argument(
        "where", nargs="+", metavar="PLACE | X Y [DEGREES]", help="a name, or meters and degrees; default: any heading"
    )
    parser.add_argument("--frame", default="", help="frame of the pose (default: that of maps)")
    parser.add_argument("--timeout", type=float, metavar="SECONDS", help="cancel the goal if it takes longer")
    parser.add_argument("--json", action="store_true", help="print each change, and the end, as one line of JSON")
    add_hub_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive there; returns the exit code."""
    numbers = _numbers(args.where)
    with open_client(args) as client, Interrupt() as interrupt:
        check_daemon(client)
        types = Types(client)
        goal = _of_place(client, types, args.where[0]) if numbers is None else _of_pose(client, numbers, args.frame)
        try:
            sent = FollowedGoal(client, ACTION, "", interrupt)
        except CliError as err:
            raise CliError(f"{err}\n{no_answer(client)}") from None
        progress = GoalProgress(sent.id, as_json=args.json)
        status = LatestMessage(client, types, STATUS_TOPIC, STATUS, progress.update)
        try:
            return _drive(sent, goal, progress, args.timeout)
        finally:
            status.close()


def _numbers(words: list[str]) -> list[float] | None:
    """Return the numbers of a pose, None for the name of a place; raises `CliError`."""
    if len(words) == 1:
        return None
    try:
        numbers = [float(argument) for argument in words]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise CliError(f"give a place's name (quoted if it has blanks) or X Y [DEGREES], not {' '.join(words)!r}")
    return numbers


def _of_place(client: CliClient, types: Types, name: str) -> dict[str, Any]:
    reply = gateway_caller(client, types, "/navigation/get_location").ask({"name": name}, _ASK_SECONDS)
    if not reply["success"]:
        raise CliError(clean(reply["message"]))
    return {"pose": reply["pose"]}


def _of_pose(client: CliClient, numbers: list[float], frame: str) -> dict[str, Any]:
    x, y, theta = (*numbers, 0.0)[:3]
    turn = {"z": math.sin(math.radians(theta) / 2.0), "w": math.cos(math.radians(theta) / 2.0)}
    pose = {
        "header": {"frame_id": frame or client.config.navigation.frame},
        "pose": {"position": {"x": x, "y": y}, "orientation": turn},
    }
    anyhow = {} if len(numbers) == 3 else {"behavior_tree": Constraints(heading=False).to_text()}
    return {"pose": pose, **anyhow}


class GoalProgress:
    """Prints each change of the goal's state, and the distance every few seconds; as JSON lines if asked to."""

    def __init__(self, goal_id: bytes, *, as_json: bool) -> None:
        self.as_json = as_json
        self._goal = base64.b64encode(goal_id).decode()
        self._screen = sys.stdout.isatty() and not as_json
        self._news: deque[dict[str, Any]] = deque(maxlen=_MOST_NEWS)
        self._status: dict[str, Any] | None = None
        self._left: float | None = None
        self._due = 0.0

    def update(self, status: dict[str, Any]) -> None:
        """Store a ``NavigationStatus`` for `refresh`; called on a thread of zenoh."""
        if status["goal_id"] == self._goal:
            self._news.append(status)

    def feedback(self, feedback: dict[str, Any]) -> None:
        """Update the distance from the planner's feedback.

        Before its first path, Nav2 and RobotPathPlanner send 0.0, and `move_base` has none: then it is unknown.
        """
        left = feedback.get("distance_remaining")
        known = isinstance(left, int | float) and math.isfinite(left) and left > 0.0
        self._left = float(left) if known else None  # type: ignore[arg-type]

    def refresh(self) -> None:
        """Print what has changed, and the distance when it is due."""
        while self._news:
            status, before = self._news.popleft(), self._status
            self._status = status
            if before is None or (status["state"], status["reason"]) != (before["state"], before["reason"]):
                self._print(status, changed=True)
        if self._status is not None and self._left is not None and time.monotonic() >= self._due:
            self._print(self._status, changed=False)

    def _print(self, status: dict[str, Any], *, changed: bool) -> None:
        self._due = time.monotonic() + (_PERIOD_SCREEN if self._screen else _PERIOD)
        if self.as_json:
            row = {"state": status["state"], "reason": status["reason"], "distance": self._left}
            print_json(row, lines=True)
            return
        line = clean(state_text(status)) + ("" if self._left is None else f", {self._left:.1f} m to go")
        if self._screen:
            print(f"\r{line}\x1b[K", end="\n" if changed else "", flush=True)
        else:
            print(line, flush=True)

    def end(self) -> None:
        """Leave the progress line."""
        if self._screen:
            print()


def _drive(sent: FollowedGoal, goal: dict[str, Any], progress: GoalProgress, timeout: float | None) -> int:
    if not progress.as_json:
        anyhow = ", in any heading" if "behavior_tree" in goal else ""
        print(f"to {clean(place_text(goal['pose'], heading=not anyhow))}{anyhow}", flush=True)
    try:
        end = sent.run(goal, timeout, progress.feedback, progress.refresh, progress.end)
    except CliError:
        progress.end()
        raise
    state, code = STATES.get(end.status, "unknown"), int(end.result.get("error_code", 0))
    reason = reason_text(str(end.result.get("error_msg", "")), code)
    if end.code in _TERMINATED:  # `FollowedGoal` has reported the end
        with contextlib.suppress(OSError):  # the terminal may be closed
            if progress.as_json:
                print_json({"status": state, "reason": reason, "code": code}, lines=True)
        return end.code
    progress.refresh()
    progress.end()
    if progress.as_json:
        print_json({"status": state, "reason": reason, "code": code}, lines=True)
    elif end.status == SUCCEEDED:
        print("arrived")
    else:
        print(f"midspan: {state}" + (f": {clean(reason)}" if reason else ""), file=sys.stderr)
    return end.code or (0 if end.status == SUCCEEDED else 1)
