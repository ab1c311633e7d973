"""``midspan map explore``: drive to the frontiers of the growing map until none is left."""

from __future__ import annotations

import argparse
import base64
import math
import sys
import time
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

from bridge.cli.arguments import add_verb, seconds
from bridge.cli.client import CliClient, open_client
from bridge.cli.graph.goal import FollowedGoal, Interrupt, Interrupted
from bridge.cli.navigation.gateway import check_daemon, no_answer
from bridge.cli.output import CliError, print_json
from bridge.client.errors import ClientError
from bridge.client.feed import LatestMessage
from bridge.client.goals import SUCCEEDED, GoalEnd
from bridge.client.navigation import PATIENCE, STATUS, STATUS_TOPIC, pose_goal
from bridge.client.transforms import TransformListener
from bridge.client.types import Types
from bridge.config.sections.navigation import ACTION
from bridge.messages.actions import GoalState
from bridge.text import clean
from bridge.tf.errors import TransformError
from navigation.exploration import MOST_FAILURES, Exploration, FrontierGoal, NoRoomError
from navigation.frames import flat
from navigation.mapper2d.section import Mapper2DSection
from navigation.maps.grid import from_grid
from navigation.messages import GRID
from navigation.nav2_errors import reason_text
from navigation.pose import Pose
from navigation.robot_path_planner.section import RobotPathPlannerSection
from navigation.status import Fault, State
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

_FIRST_SECONDS = 20.0  # to wait for the first map with free cells, and for the robot's pose
_NEWER_SECONDS = 3.0  # to wait for a map that is newer than the last goal's end
_SETTLE_SECONDS = 5.0  # to wait after a map without frontiers, because a newer map may have some
_POLL_SECONDS = 0.1
_GOAL_SECONDS, _METER_SECONDS, _MAX_SECONDS = 60.0, 20.0, 900.0  # a goal's limit: base, per meter, maximum

COMPLETE, STOPPED, FAILING, LIMIT = "complete", "stopped", "failing", "limit"


def register(verbs: Any) -> None:
    parser = add_verb(
        verbs, "explore", run, "drive to the borders of the growing map until none is left",
        "Explores an unknown floor by sending goals to the gateway. The goals are frontiers, where free cells of"
        " Mapper2D's map touch unknown cells; near and large frontiers come first. It ends when no reachable frontier"
        f" is left, when a client stops the robot or sends another goal, after {MOST_FAILURES} failed goals in a row,"
        " and at the limits of time and goals. Ctrl-C, SIGTERM and SIGHUP cancel the goal. The exit code is 0 if the"
        " exploration is complete, 1 if it ended earlier, and 130, 143 or 129 after these signals.",
        example="midspan map explore --seconds 1800",
    )  # fmt: skip
    parser.add_argument("--topic", help="topic of the growing map (default: that of Mapper2D)")
    parser.add_argument(
        "--radius",
        type=float,
        metavar="METERS",
        help="distance of paths from walls (default: that of robot_path_planner)",
    )
    parser.add_argument("--seconds", type=seconds, default=3600.0, help="end after this time (default 3600)")
    parser.add_argument("--goals", type=int, default=200, help="end after this number of goals (default 200)")
    parser.add_argument("--json", action="store_true", help="print each goal, and the end, as one line of JSON")


def run(args: argparse.Namespace) -> int:
    if args.goals < 1:
        raise CliError(f"--goals must be above 0, not {args.goals}")
    with open_client(args) as client, Interrupt() as interrupt:
        check_daemon(client)
        section = client.config.section(RobotPathPlannerSection)
        radius = section.robot_radius if args.radius is None else args.radius
        if not 0.0 < radius <= 10.0:
            raise CliError(f"--radius must be above 0 and at most 10 m, not {radius:g}")
        topic = args.topic or client.config.section(Mapper2DSection).topic or "/map"
        used = section.map or client.config.navigation.map
        if client.here and client.config.navigation.planner == "robot_path_planner" and used != topic:
            print(
                f"midspan: warning: the planner uses the map {used!r}, not {topic}: set navigation.map: {topic}",
                file=sys.stderr,
            )
        watch = _Watch()
        status = LatestMessage(client, Types(client), STATUS_TOPIC, STATUS, watch.update)
        try:
            if status.wait(PATIENCE) is None:
                raise CliError(no_answer(client))
            with _Floor(client, topic) as floor:
                return _Explorer(args, client, interrupt, watch, floor, Exploration(radius, section.clearance)).run()
        finally:
            status.close()


class _Floor:
    """The growing map, and the robot's pose on it."""

    def __init__(self, client: CliClient, topic: str) -> None:
        self._client, self._topic = client, topic
        self._frames = TransformListener(client)

    def __enter__(self) -> Self:
        self._maps = LatestMessage(self._client, Types(self._client), self._topic, GRID)
        self._frames.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._maps.close()
        self._frames.close()

    @property
    def count(self) -> int:
        """The number of maps that have arrived."""
        return self._maps.count

    def newer(self, count: int, seconds: float) -> bool:
        """Wait for a map after the ``count``-th one; return whether it has arrived in time."""
        self._frames.refresh()
        return self._maps.newer(count, seconds)

    def map(self) -> MapGrid2D | None:
        """Return the newest map; None before the first map, and if the newest has no free cells."""
        message = self._maps.read()
        if message is None:
            return None
        grid = from_grid(message, "map")
        return grid if (grid.flags == MapFlag.FREE).any() else None

    def robot(self) -> Pose | None:
        """Return the robot's pose on the map; None if it is unknown."""
        section = self._client.config.navigation
        try:
            return flat(self._frames.buffer.lookup_transform(section.frame, section.base_frame))
        except TransformError:
            return None

    def missing(self) -> str:
        """Return why the map or the robot's pose is missing, as the text of an error."""
        section = self._client.config.navigation
        if not self.count:
            return f"no map on {self._topic}: enable modules.mapper2d, or set the map's topic with --topic"
        if self.map() is None:
            return f"the map on {self._topic} has no free cells: does Mapper2D receive scans? see 'midspan status'"
        return f"the robot's pose on the map is unknown: no transform from {section.frame} to {section.base_frame}"


class _Watch:
    """Detects from the gateway's status that a client has stopped the robot or sent a goal, even between two goals.

    After the first goal has begun, the gateway is idle only if a goal was canceled or the robot was stopped. Before
    that, an idle gateway means nothing, and only a reason that begins with `_STOPPING` shows a stop.
    """

    def __init__(self) -> None:
        self.goals: set[str] = set()  # the ids of this command's goals, encoded as in the status
        self.why = ""  # why the exploration ends, "" while it continues
        self._seen = self._begun = False

    def update(self, status: dict[str, Any]) -> None:
        """Handle a ``NavigationStatus``; called on a zenoh thread."""
        goal, state, reason = status["goal_id"], status["state"], str(status["reason"])
        if goal in self.goals:
            self._begun = True
        elif self._seen and goal != _NO_GOAL:
            self.why = self.why or "another client has sent a goal"
        elif state == State.IDLE.value if self._begun else (self._seen and reason.startswith(_STOPPING)):
            self.why = self.why or reason.removeprefix(_STOPPING) or "the robot was stopped"
        self._seen = True


_STOPPING = "stopping: "
_NO_GOAL = base64.b64encode(bytes(16)).decode()


class _Ending(NamedTuple):
    status: str
    reason: str


@dataclass
class _Explorer:
    """Drives to one frontier after another."""

    args: argparse.Namespace
    client: CliClient
    interrupt: Interrupt
    watch: _Watch
    floor: _Floor
    exploration: Exploration

    def run(self) -> int:
        """Explore the floor; return the exit code."""
        self._until = time.monotonic() + self.args.seconds
        self._reached, self._timed_out, self._trouble, self._no_start = 0, "", "", ""
        began = time.monotonic()
        try:
            ending, code = self._explore()
        except Interrupted as err:  # between two goals
            ending, code = _Ending(STOPPED, err.args[0]), err.code
        self._report(ending, time.monotonic() - began)
        return code or int(ending.status != COMPLETE)

    def _explore(self) -> tuple[_Ending, int]:
        while True:
            goal = self._next()
            ending = self._ending()
            if ending is None and goal is None:
                ending = _Ending(COMPLETE, "no reachable frontier is left")
            if ending is not None or goal is None:
                assert ending is not None
                return ending, 0
            code = self._drive(goal)
            if code:
                return _Ending(STOPPED, "a signal ended the exploration"), code

    def _ending(self) -> _Ending | None:
        """Return why the exploration ends before it is complete; None if it continues."""
        if self._timed_out:
            return _Ending(LIMIT, self._timed_out)
        if self._no_start:
            return _Ending(FAILING, f"no path can begin at the robot's position: {self._no_start}")
        if self.watch.why:
            return _Ending(STOPPED, self.watch.why)
        if self.exploration.failures >= MOST_FAILURES:
            return _Ending(FAILING, f"{MOST_FAILURES} goals in a row failed; the last reason: {self._trouble}")
        if self.exploration.sent >= self.args.goals:
            return _Ending(LIMIT, f"{self.args.goals} goals were sent")
        if time.monotonic() >= self._until:
            return _Ending(LIMIT, f"{self.args.seconds:g} s have passed")
        return None

    def _next(self) -> FrontierGoal | None:
        """Return the next goal; None if no frontier appears within `_SETTLE_SECONDS`, or if the exploration ends."""
        self._await(self.floor.count, _NEWER_SECONDS if self.exploration.sent else 0.0)
        missing_until = time.monotonic() + _FIRST_SECONDS
        settled_at = math.inf
        while self._ending() is None:
            count, grid, robot = self.floor.count, self.floor.map(), self.floor.robot()
            if grid is None or robot is None:
                if time.monotonic() >= missing_until:
                    raise CliError(self.floor.missing())
            else:
                trouble, goal = "", None
                try:
                    goal = self.exploration.choose(grid, robot)
                except NoRoomError as err:
                    trouble = str(err)
                if goal is not None:
                    return goal
                settled_at = min(settled_at, time.monotonic() + _SETTLE_SECONDS)
                if time.monotonic() >= settled_at:
                    self._no_start = trouble
                    return None
            self._await(count, 1.0)
        return None

    def _await(self, count: int, seconds: float) -> None:
        """Wait for a newer map, and check for signals and a stop meanwhile."""
        end = time.monotonic() + seconds
        while True:
            self.interrupt.check()
            left = end - time.monotonic()
            if left <= 0.0 or self.watch.why or self.floor.newer(count, min(left, _POLL_SECONDS)):
                return

    def _drive(self, goal: FrontierGoal) -> int:
        """Drive to a frontier; return the exit code for a received signal, else 0."""
        pose, frame = goal.pose, self.client.config.navigation.frame
        message = pose_goal(frame, (pose.x, pose.y, math.degrees(pose.theta)))
        try:
            sent = FollowedGoal(self.client, ACTION, "", self.interrupt)
        except ClientError as err:
            raise CliError(f"{err}\n{no_answer(self.client)}") from None
        if self.watch.why:  # since the frontier was chosen
            sent.close()
            return 0
        self.watch.goals.add(base64.b64encode(sent.id).decode())
        seconds = min(_GOAL_SECONDS + _METER_SECONDS * goal.cost, _MAX_SECONDS, self._until - time.monotonic())
        seconds = max(seconds, 0.1)
        over = time.monotonic() + seconds
        self.exploration.begin()
        self._show_goal(goal)
        canceled: list[str] = []

        def check() -> None:
            if self.watch.why and not canceled:
                canceled.append(self.watch.why)
                sent.cancel()

        try:
            end, code = sent.run(message, seconds, lambda _feedback: None, check)
        finally:
            sent.close()
        if not code:
            self._judge(goal, end, seconds if time.monotonic() >= over else 0.0)
        return code

    def _judge(self, goal: FrontierGoal, end: GoalEnd, canceled_after: float) -> None:
        """Record how a goal ended; ``canceled_after`` is the time limit at which this command canceled it, or 0."""
        fault = int(end.result.get("error_code", 0))
        reason = reason_text(str(end.result.get("error_msg", "")), fault)
        if end.status == SUCCEEDED:
            self._reached += 1
            self.exploration.reached(goal)
        elif end.status == GoalState.CANCELED and canceled_after:
            # no further goal is sent, because an idle gateway's status would not show that a client stops the robot
            self._timed_out = f"a goal took more than {canceled_after:.0f} s"
        elif end.status == GoalState.CANCELED or fault == Fault.MAY_MOVE:
            self.watch.why = self.watch.why or reason or "the goal was canceled"
        else:
            self._trouble = reason or "no reason given"
            self.exploration.failed(goal)
            self._show("failed", f"not reached: {clean(self._trouble)}", reason=self._trouble)

    def _show_goal(self, goal: FrontierGoal) -> None:
        pose, number = goal.pose, self.exploration.sent
        text = f"goal {number}: {pose.x:.2f}, {pose.y:.2f} m, to a frontier of {goal.size:.1f} m"
        goal_pose = {"x": round(pose.x, 3), "y": round(pose.y, 3), "degrees": round(math.degrees(pose.theta), 1)}
        self._show("goal", text, number=number, **goal_pose, frontier=round(goal.size, 2))

    def _show(self, event: str, text: str, **values: Any) -> None:
        if self.args.json:
            print_json({"event": event, **values}, lines=True)
        else:
            print(text, flush=True)

    def _report(self, ending: _Ending, seconds: float) -> None:
        grid, sent = self.floor.map(), self.exploration.sent
        area = 0.0 if grid is None else float((grid.flags == MapFlag.FREE).sum()) * grid.resolution**2
        text = f"{ending.status}: {clean(ending.reason)}; {self._reached} of {sent} goals reached, {area:.0f} m2 free"
        values = {"status": ending.status, "reason": ending.reason, "goals": sent, "reached": self._reached}
        self._show("end", text, **values, seconds=round(seconds, 1), area=round(area, 1))
