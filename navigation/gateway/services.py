"""The gateway's services on the hub, and YARP's ``INavigation2D``."""

# ruff: noqa: N802, D102 - YARP's names; `yarp_compat.dev.inavigation2d` describes them

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from typing_extensions import override

from bridge.modules.host import Host, ModuleNode
from bridge.modules.services import Answer
from navigation.gateway.choice import RequestError
from navigation.gateway.entry import STOP_SERVICE
from navigation.gateway.gateway import Gateway
from navigation.gateway.stop import StopAnswer, wait_for
from navigation.gateway.targets import StoredPlaces, Target
from navigation.gateway.velocities import CLIENT, VelocityCommander, YarpVelocity
from navigation.pose import Pose
from navigation.yarp import Calls, NavigationDevice
from yarp_compat.dev.inavigation2d import NavigationMapTypeEnum, TrajectoryTypeEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode

TRIGGER, NAMED = "std_srvs/srv/Trigger", "midspan_msgs/srv/Named"
GET_LOCATION = "midspan_msgs/srv/GetLocation"


class HubServices:
    """The gateway's services on the hub. Used only on the module's thread."""

    def __init__(self, node: ModuleNode, gateway: Gateway, places: StoredPlaces, commander: VelocityCommander) -> None:
        self._gateway, self._places, self._commander = gateway, places, commander
        actions: dict[str, tuple[str, Callable[[str], str | None]]] = {
            "resume": (TRIGGER, lambda _name: gateway.execution.resume()),
            "choose_planner": (NAMED, gateway.choose),
            "go_to": (NAMED, self._go_to),
        }
        for name, (kind, action) in actions.items():
            node.server(f"/navigation/{name}", kind, _server_of(action))
        node.server(STOP_SERVICE, TRIGGER, self._stop)
        node.server("/navigation/pause", TRIGGER, self._pause)
        node.server("/navigation/get_location", GET_LOCATION, self._locate)

    def _stop(self, _request: dict[str, Any], answer: Answer) -> None:
        self._commander.stop_client()
        self._answer_when_confirmed(self._gateway.stop(), answer)

    def _pause(self, _request: dict[str, Any], answer: Answer) -> None:
        try:
            self._gateway.execution.pause()
        except RequestError as err:
            answer({"success": False, "message": str(err)})
        else:
            self._answer_when_confirmed("", answer)

    def _answer_when_confirmed(self, done: str, answer: Answer) -> None:
        self._gateway.when_confirmed(
            lambda trouble: answer({"success": not trouble, "message": trouble or done}),
        )

    def _go_to(self, name: str) -> str:
        self._gateway.go([self._places.find(name)], "a client of /navigation/go_to", name)
        return f"driving to {name}; /navigation/status reports the progress"

    def _locate(self, request: dict[str, Any], answer: Answer) -> None:
        try:
            target = self._places.find(str(request["name"]))
        except LookupError as err:
            answer({"success": False, "message": str(err)})
        else:
            answer({"success": True, "message": "", "pose": target.stamped(self._gateway.robot())})


def _server_of(action: Callable[[str], str | None]) -> Callable[[dict[str, Any], Answer], None]:
    def serve(request: dict[str, Any], answer: Answer) -> None:
        try:
            reply = action(str(request.get("name", "")))
        except (RequestError, LookupError) as err:
            answer({"success": False, "message": str(err)})
        else:
            answer({"success": True, "message": reply or ""})

    return serve


_FRESH_SECONDS = 0.3
"""A velocity that waited longer for the module's thread is refused, because its client has sent another or stopped."""


class GatewayDevice(NavigationDevice):
    """The gateway as a YARP device; see `yarp_compat.dev.inavigation2d`. Called on connections' threads."""

    def __init__(
        self,
        host: Host,
        gateway: Gateway,
        places: StoredPlaces,
        commander: VelocityCommander,
        stop: Callable[[], StopAnswer],  # starts stopping the robot; the answer arrives when the stop is confirmed
    ) -> None:
        self._gateway, self._places, self._commander, self._log = gateway, places, commander, host.log
        self._stop, self._post = stop, host.loop.post
        super().__init__(Calls(host.loop, RequestError, LookupError))

    # -- targets -------------------------------------------------------------------------------------------------------

    def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> None:
        self._accept(lambda: self._begin([self._places.known(loc)]))

    def followPath(self, path: Map2DPath) -> None:
        self._accept(lambda: self._begin([self._places.known(place) for place in path.waypoints]))

    # -- control -------------------------------------------------------------------------------------------------------

    def getNavigationStatus(self) -> str:
        """Return the status without waiting for the module's thread, which may be busy."""
        return self._gateway.state().state.value

    def stopNavigation(self) -> None:
        """Stop the robot; the reply waits until the stop is confirmed."""
        self._wait_for("stop", self._do(self._stop))

    def suspendNavigation(self, time_s: float) -> None:
        """Pause the drive; the reply waits until the pause is confirmed."""

        def pause() -> StopAnswer:
            self._gateway.execution.pause(time_s)
            answer = StopAnswer()
            self._gateway.when_confirmed(answer.put)
            return answer

        self._wait_for("pause", self._do(pause))

    def _wait_for(self, what: str, answer: StopAnswer) -> None:
        trouble = wait_for(answer)
        if trouble:
            self._log.warning("a %s of %s is not confirmed: %s", what, CLIENT, trouble)
            raise CallFailed(ReturnCode.METHOD_FAILED, trouble)

    def resumeNavigation(self) -> None:
        self._move(self._gateway.execution.resume)

    def recomputeCurrentNavigationPath(self) -> None:
        self._do(self._gateway.execution.recompute)

    def getAllNavigationWaypoints(self, kind: TrajectoryTypeEnum) -> Map2DPath | None:  # noqa: ARG002
        """Return the path for either kind, like YARP's robotPathPlanner."""
        return self._do(lambda: Map2DPath(self._waypoints()) if self._gateway.driving else None)

    def getCurrentNavigationWaypoint(self) -> Map2DLocation | None:
        return self._do(self._waypoint)

    def getCurrentNavigationMap(self, kind: NavigationMapTypeEnum) -> MapGrid2D | None:
        if kind is NavigationMapTypeEnum.global_map:
            return self._do(self._places.map)
        return self._do(lambda: self._places.grid(self._gateway.link.telemetry.local_map))

    # -- velocities ----------------------------------------------------------------------------------------------------

    def applyVelocityCommand(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> None:
        velocity = YarpVelocity(x_vel, y_vel, theta_vel)

        def command() -> None:
            self._commander.command(velocity, timeout, planner_drives=self._gateway.has_base)

        try:
            self._move(command, _FRESH_SECONDS)
        except CallFailed as err:
            if err.code is ReturnCode.NOT_READY:  # it was dropped, but its client does not pause
                self._post(lambda: self._commander.note(velocity, timeout))
            raise

    def getLastVelocityCommand(self) -> tuple[float, float, float] | None:
        return self._do(lambda: self._commander.last)

    # -- parts ---------------------------------------------------------------------------------------------------------

    @override
    def _accept(self, action: Callable[[], None]) -> None:
        """Accept a goal; log the reason for a refusal, because YARP's reply cannot contain it."""
        try:
            super()._accept(action)
        except CallFailed as err:
            self._log.warning("a goal of %s is refused: %s", CLIENT, err)
            raise

    def _begin(self, targets: Sequence[Target]) -> None:
        self._gateway.go(targets, CLIENT)

    @override
    def _robot(self) -> Pose:
        robot = self._gateway.robot()
        if robot is None:
            raise LookupError("the robot's pose is unknown; ask again when it is localized")
        return robot

    @override
    def _go_to(self, pose: Pose) -> None:
        self._begin([Target(pose, self._gateway.frame)])

    @override
    def _target(self) -> Map2DLocation | None:
        drive, link = self._gateway.drive, self._gateway.link
        if drive is not None:
            return self._places.location(drive.targets[-1])
        pose = link.telemetry.pose(link.foreign[-1]) if link.foreign else None
        return None if pose is None else self._places.location(pose)

    def _waypoints(self) -> list[Map2DLocation]:
        """Return the planner's path, or the remaining goals if the planner publishes no path."""
        path = self._gateway.link.telemetry.path
        poses: Sequence[Any] = path["poses"] if path is not None else []
        drive = self._gateway.drive
        left = [] if drive is None else list(drive.targets[drive.at :])
        return [self._places.location(place) for place in (poses or left)]

    def _waypoint(self) -> Map2DLocation | None:
        path, robot = (self._waypoints() if self._gateway.driving else []), self._gateway.robot()
        if not path or robot is None:
            return path[0] if path else None
        nearest = min(range(len(path)), key=lambda i: math.hypot(path[i].x - robot.x, path[i].y - robot.y))
        return path[min(nearest + 1, len(path) - 1)]
