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

from bridge.cli.arguments import add_hub_arguments, seconds
from bridge.cli.client import open_client
from bridge.cli.graph.goal import FollowedGoal, Interrupt
from bridge.cli.navigation.gateway import check_daemon, gateway_caller, no_answer
from bridge.cli.output import CliError, print_json
from bridge.client.errors import ClientError
from bridge.client.feed import LatestMessage
from bridge.client.goals import STATES, SUCCEEDED, GoalEnd
from bridge.client.navigation import STATUS, STATUS_TOPIC, place_goal, place_text, pose_goal, state_text
from bridge.client.types import Types
from bridge.config.sections.navigation import ACTION, THROUGH_POSES
from bridge.text import clean
from navigation.nav2_errors import reason_text

_PERIOD, _PERIOD_SCREEN = 5.0, 0.5  # seconds between distances, in a pipe and on a terminal
_MAX_NEWS = 100
_TERMINATED = (129, 143)
"""Exit codes for SIGHUP and SIGTERM."""


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Drives to locations or areas of the store in turn, or to a pose on the map, with the chosen planner, and shows"
        " the progress. Ctrl-C, SIGTERM and SIGHUP cancel the goal. The exit code is 0 if the robot arrived, 1 if it"
        " did not, and 130, 143 or 129 after these signals."
    )
    parser.epilog = (
        "Examples: midspan goto kitchen; midspan goto hall office; midspan goto 1.0 -2.0 90; midspan goto -1.5 2"
    )
    parser.add_argument(
        "where",
        nargs="+",
        metavar="PLACE ... | X Y [DEGREES]",
        help="names, or meters and degrees; without DEGREES: any heading",
    )
    parser.add_argument("--frame", default="", help="frame of the pose (default: the maps' frame)")
    parser.add_argument("--timeout", type=seconds, metavar="SECONDS", help="cancel the goal if it takes longer")
    parser.add_argument("--json", action="store_true", help="print each change, and the end, as one line of JSON")
    add_hub_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    numbers = _numbers(args.where)
    several = numbers is None and len(args.where) > 1
    with open_client(args) as client, Interrupt() as interrupt:
        check_daemon(client)
        types = Types(client)
        if numbers is None:
            locate = gateway_caller(client, types, "get_location")
            poses = [place_goal(locate, name)["pose"] for name in args.where]
            goal = {"poses": poses} if several else {"pose": poses[0]}
        else:
            goal = pose_goal(args.frame or client.config.navigation.frame, numbers)
        try:
            sent = FollowedGoal(client, THROUGH_POSES if several else ACTION, "", interrupt)
        except ClientError as err:
            raise CliError(f"{err}\n{no_answer(client)}") from None
        progress = GoalProgress(sent.id, as_json=args.json)
        status = LatestMessage(client, types, STATUS_TOPIC, STATUS, progress.update)
        try:
            return _drive(sent, goal, progress, args.timeout)
        finally:
            status.close()


def _numbers(words: list[str]) -> list[float] | None:
    """Return the numbers of a pose, None for names of places; raises `CliError` if the words are neither."""
    numbers = [number for number in map(_number, words) if number is not None]
    if not numbers or len(words) == 1:
        return None
    if len(numbers) != len(words) or len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise CliError(f"give names of places (quoted if they have blanks) or X Y [DEGREES], not {' '.join(words)!r}")
    return numbers


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


class GoalProgress:
    """Prints each change of the goal's state, and the distance every few seconds; as JSON lines if asked to."""

    def __init__(self, goal_id: bytes, *, as_json: bool) -> None:
        self.as_json = as_json
        self._goal = base64.b64encode(goal_id).decode()
        self._screen = sys.stdout.isatty() and not as_json
        self._news: deque[dict[str, Any]] = deque(maxlen=_MAX_NEWS)
        self._status: dict[str, Any] | None = None
        self._left: float | None = None
        self._due = 0.0

    def update(self, status: dict[str, Any]) -> None:
        """Store a ``NavigationStatus`` for `refresh`; called on a zenoh thread."""
        if status["goal_id"] == self._goal:
            self._news.append(status)

    def feedback(self, feedback: dict[str, Any]) -> None:
        """Update the distance from the planner's feedback.

        The distance is unknown before the first path, when Nav2 and RobotPathPlanner send 0.0, and with `move_base`,
        which sends none.
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
        """End the progress line."""
        if self._screen:
            print()


def _drive(sent: FollowedGoal, goal: dict[str, Any], progress: GoalProgress, timeout: float | None) -> int:
    if not progress.as_json:
        any_heading = ", in any heading" if "behavior_tree" in goal else ""
        places = (place_text(pose, heading=not any_heading) for pose in goal.get("poses") or [goal["pose"]])
        print(f"to {clean('; '.join(places))}{any_heading}", flush=True)
    try:
        end, signaled = sent.run(goal, timeout, progress.feedback, progress.refresh, progress.end)
    except ClientError:
        progress.end()
        raise
    if signaled not in _TERMINATED:
        progress.refresh()
        progress.end()
    return report_end(end, signaled, "arrived", as_json=progress.as_json)


def report_end(end: GoalEnd, signaled: int, done: str, trouble: str = "", *, as_json: bool) -> int:
    """Print how a goal ended; return the exit code.

    Args:
        end: how the goal ended.
        signaled: the exit code for the signal that canceled it, 0 if no signal did.
        done: the text for a goal that succeeded.
        trouble: why the goal has not succeeded completely, "" if it has.
        as_json: print one line of JSON instead.
    """
    state, code = STATES.get(end.status, "unknown"), int(end.result.get("error_code", 0))
    reason = trouble or reason_text(str(end.result.get("error_msg", "")), code)
    if signaled in _TERMINATED:  # `FollowedGoal` has reported the end
        with contextlib.suppress(OSError):  # the terminal may be closed
            if as_json:
                print_json({"status": state, "reason": reason, "code": code}, lines=True)
        return signaled
    succeeded = end.status == SUCCEEDED and not trouble
    if as_json:
        print_json({"status": state, "reason": reason, "code": code}, lines=True)
    elif succeeded:
        print(done)
    else:
        print(f"midspan: {state}" + (f": {clean(reason)}" if reason else ""), file=sys.stderr)
    return signaled or (0 if succeeded else 1)
