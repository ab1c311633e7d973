"""The gateway's services on the hub, YARP's ``INavigation2D``, and velocities that pass the planner for a while."""

# ruff: noqa: N802, D102 - YARP's names, and what they do is said in `yarp_compat.dev.inavigation2d`

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host, ModuleNode
from bridge.modules.loop import Timer
from bridge.modules.services import Answer
from navigation.gateway.drive import StoredPlaces, Target
from navigation.gateway.gateway import Gateway
from navigation.gateway.planner_link import RequestError
from navigation.gateway.stop import StopAnswer, waited_for
from navigation.messages import TWIST
from navigation.pose import Pose
from navigation.yarp import Calls, NavigationDevice
from yarp_compat.dev.inavigation2d import NavigationMapTypeEnum, TrajectoryTypeEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode

LONGEST_SECONDS = 1.0
"""A client that wants to drive on repeats its command; one that has gone is obeyed no longer than this."""

_PERIOD = 0.05


class YarpVelocity(NamedTuple):
    """A velocity as YARP commands it: m/s, m/s, deg/s."""

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


class VelocityCommander:
    """Repeats a velocity on the base's topic until its time is over, and then says zero. On the module's thread."""

    def __init__(self, host: Host, topic: str) -> None:
        self._host = host
        self._out = host.node.publisher(topic, TWIST, Qos(depth=1), priority="command")
        self._velocity, self._until = YarpVelocity(), 0.0
        self._timer: Timer | None = None

    @property
    def last(self) -> YarpVelocity | None:
        """The current command; None once its time is over."""
        return self._velocity if time.monotonic() <= self._until else None

    def command(self, velocity: YarpVelocity, seconds: float) -> None:
        """Command for so many seconds."""
        self._velocity, self._until = velocity, time.monotonic() + min(max(seconds, 0.0), LONGEST_SECONDS)
        self._publish(velocity)
        if self._timer is None:
            self._timer = self._host.loop.every(_PERIOD, self._again)

    def stop(self) -> None:
        """Command nothing more; the base stands where it was being commanded."""
        if self._timer is not None:
            self._timer.close()
            self._timer = None
            self._until = 0.0
            self._publish(YarpVelocity())

    def halt(self) -> None:
        """Say zero for `LONGEST_SECONDS`, whoever commands beside it."""
        self.command(YarpVelocity(), LONGEST_SECONDS)

    def _again(self) -> None:
        if self.last is None:
            self.stop()
        else:
            self._publish(self._velocity)

    def _publish(self, velocity: YarpVelocity) -> None:
        turn = math.radians(velocity.turn)
        self._out.publish({"linear": {"x": velocity.x, "y": velocity.y}, "angular": {"z": turn}})


TRIGGER, NAMED = "std_srvs/srv/Trigger", "midspan_msgs/srv/Named"
GET_LOCATION = "midspan_msgs/srv/GetLocation"


class HubServices:
    """Serves them; all on the module's thread."""

    def __init__(self, node: ModuleNode, gateway: Gateway, places: StoredPlaces, commander: VelocityCommander) -> None:
        self._gateway, self._places, self._commander = gateway, places, commander
        done: dict[str, tuple[str, Callable[[str], str | None]]] = {
            "pause": (TRIGGER, lambda _name: gateway.pause()),
            "resume": (TRIGGER, lambda _name: gateway.resume()),
            "choose_planner": (NAMED, gateway.choose),
            "go_to": (NAMED, self._go_to),
        }
        for name, (kind, action) in done.items():
            node.server(f"/navigation/{name}", kind, _serving(action))
        node.server("/navigation/stop", TRIGGER, self._stop)
        node.server("/navigation/get_location", GET_LOCATION, self._locate)

    def _stop(self, _request: dict[str, Any], answer: Answer) -> None:
        self._commander.stop()
        done = self._gateway.stop()
        self._gateway.when_stopped(lambda trouble: answer({"success": not trouble, "message": trouble or done}))

    def _go_to(self, name: str) -> str:
        self._gateway.go([self._places.find(name)], "a caller of /navigation/go_to", name)
        return f"drives to {name}; /navigation/status tells how it gets on"

    def _locate(self, request: dict[str, Any], answer: Answer) -> None:
        try:
            found = self._places.find(str(request["name"]))
        except LookupError as err:
            answer({"success": False, "message": str(err)})
        else:
            answer({"success": True, "message": "", "pose": found.stamped(self._gateway.robot())})


def _serving(action: Callable[[str], str | None]) -> Callable[[dict[str, Any], Answer], None]:
    def serve(request: dict[str, Any], answer: Answer) -> None:
        try:
            said = action(str(request.get("name", "")))
        except (RequestError, LookupError) as err:
            answer({"success": False, "message": str(err)})
        else:
            answer({"success": True, "message": said or ""})

    return serve


WHO = "a YARP client"
_FRESH_SECONDS = 0.3
"""A velocity that waited longer for the module's thread is not obeyed: its client has another one by then, or stops."""


class GatewayDevice(NavigationDevice):
    """The gateway as a YARP device; see `yarp_compat.dev.inavigation2d`. Called on threads of connections."""

    def __init__(
        self,
        host: Host,
        gateway: Gateway,
        places: StoredPlaces,
        commander: VelocityCommander,
        stop: Callable[[], StopAnswer],  # begins to stop the robot; what it returns says whether that is confirmed
    ) -> None:
        self._gateway, self._places, self._commander, self._log = gateway, places, commander, host.log
        self._stop = stop
        super().__init__(Calls(host.loop, RequestError, LookupError))

    # -- targets -------------------------------------------------------------------------------------------------------

    def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> None:
        self._accept(lambda: self._begin([self._places.known(loc)]))

    def followPath(self, path: Map2DPath) -> None:
        self._accept(lambda: self._begin([self._places.known(place) for place in path.waypoints]))

    # -- control -------------------------------------------------------------------------------------------------------

    def getNavigationStatus(self) -> str:
        """Without waiting for the module's thread: one that is busy for long is no error."""
        return self._gateway.state().state.value

    def stopNavigation(self) -> None:
        """The answer waits for what confirms the stop: the planner has let go, or the base stands."""
        trouble = waited_for(self._do(self._stop))
        if trouble:
            self._log.warning("a stop of %s is not confirmed: %s", WHO, trouble)
            raise CallFailed(ReturnCode.METHOD_FAILED, trouble)

    def suspendNavigation(self, time_s: float) -> None:
        self._do(lambda: self._gateway.pause(time_s))

    def resumeNavigation(self) -> None:
        self._move(self._gateway.resume)

    def recomputeCurrentNavigationPath(self) -> None:
        self._do(self._gateway.recompute)

    def getAllNavigationWaypoints(self, kind: TrajectoryTypeEnum) -> Map2DPath | None:  # noqa: ARG002
        """YARP's robotPathPlanner answers either kind with its way."""
        return self._do(lambda: Map2DPath(self._way()) if self._gateway.driving else None)

    def getCurrentNavigationWaypoint(self) -> Map2DLocation | None:
        return self._do(self._waypoint)

    def getCurrentNavigationMap(self, kind: NavigationMapTypeEnum) -> MapGrid2D | None:
        if kind is NavigationMapTypeEnum.global_map:
            return self._do(self._places.map)
        return self._do(lambda: self._places.grid(self._gateway.link.local_map))

    # -- velocities ----------------------------------------------------------------------------------------------------

    def applyVelocityCommand(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> None:
        def command() -> None:
            if self._gateway.has_base:
                raise RequestError("the planner drives; stop or suspend it first")
            self._commander.command(YarpVelocity(x_vel, y_vel, theta_vel), timeout)

        self._move(command, _FRESH_SECONDS)

    def getLastVelocityCommand(self) -> tuple[float, float, float] | None:
        return self._do(lambda: self._commander.last)

    # -- parts ---------------------------------------------------------------------------------------------------------

    def _accept(self, action: Callable[[], None]) -> None:
        """Take a goal; YARP's answer has no words for why it is refused, so the log says it."""
        try:
            super()._accept(action)
        except CallFailed as err:
            self._log.warning("a goal of %s is refused: %s", WHO, err)
            raise

    def _begin(self, targets: Sequence[Target]) -> None:
        self._gateway.go(targets, WHO)

    def _robot(self) -> Pose:
        robot = self._gateway.robot()
        if robot is None:
            raise LookupError("it is not known where the robot is; ask again once its localisation says so")
        return robot

    def _go_to(self, pose: Pose) -> None:
        self._begin([Target(pose, self._gateway.frame)])

    def _target(self) -> Map2DLocation | None:
        drive, link = self._gateway.drive, self._gateway.link
        if drive is not None:
            return self._places.location(drive.targets[-1])
        told = link.pose(link.others[-1]) if link.others else None
        return None if told is None else self._places.location(told)

    def _way(self) -> list[Map2DLocation]:
        """The planner's path, or the goals that are left if it publishes no path."""
        path = self._gateway.link.path
        poses: Sequence[Any] = path["poses"] if path is not None else []
        drive = self._gateway.drive
        left = [] if drive is None else list(drive.targets[drive.at :])
        return [self._places.location(one) for one in (poses or left)]

    def _waypoint(self) -> Map2DLocation | None:
        """The place of its way that the robot comes to next."""
        way, robot = (self._way() if self._gateway.driving else []), self._gateway.robot()
        if not way or robot is None:
            return way[0] if way else None
        nearest = min(range(len(way)), key=lambda i: math.hypot(way[i].x - robot.x, way[i].y - robot.y))
        return way[min(nearest + 1, len(way) - 1)]
