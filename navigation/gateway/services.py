"""The gateway's services on the hub, YARP's ``INavigation2D``, and direct velocity commands."""

# ruff: noqa: N802, D102 - YARP's names; `yarp_compat.dev.inavigation2d` describes them

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from typing_extensions import override

from bridge.client.manual import ManualControl
from bridge.client.velocity import STOP_SECONDS
from bridge.modules.host import Host, ModuleNode
from bridge.modules.loop import Timer
from bridge.modules.services import Answer
from bridge.modules.velocity import velocity_publisher
from navigation.gateway.choice import RequestError
from navigation.gateway.entry import STOP_SERVICE
from navigation.gateway.gateway import Gateway
from navigation.gateway.stop import OVERRIDE_SECONDS, StopAnswer, wait_for
from navigation.gateway.targets import StoredPlaces, Target
from navigation.pose import Pose
from navigation.yarp import Calls, NavigationDevice
from yarp_compat.dev.inavigation2d import NavigationMapTypeEnum, TrajectoryTypeEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode

CLIENT = "a YARP client"

LONGEST_SECONDS = 1.0
"""Maximum duration of a velocity command; clients repeat their command to keep driving."""

_PAUSE_SECONDS = 0.3
_STOPPED = f"the robot was stopped; first send no velocity for the command's time-out, at least {_PAUSE_SECONDS:g} s"

_LOG_SECONDS = 5.0  # a refusal is logged again if the one before it was earlier
_PERIOD = 0.05  # seconds between two messages of a command
_ZEROS = round(STOP_SECONDS / _PERIOD)  # after a velocity


class YarpVelocity(NamedTuple):
    """A velocity as YARP commands it: m/s, m/s, deg/s."""

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


class VelocityCommander:
    """Repeats a velocity on the base's topic for a limited time, then zero for `STOP_SECONDS`. Not thread-safe.

    To others, the client is a person who drives manually (`bridge.client.manual.ManualControl`).

    Args:
        topic: the topic of the base's velocities.
        busy: whether a planner commands the base. Zeros would slow it, or a person who drives manually; a new command
            ends the zeros, too.
    """

    def __init__(self, host: Host, topic: str, busy: Callable[[], bool]) -> None:
        self._host, self._busy = host, busy
        self._publisher = velocity_publisher(host, topic)
        self._control = ManualControl(host.node.hub, topic)
        self._refused, self._refused_at = "", -math.inf  # the reason for the last refusal, and its time
        self._velocity, self._until = YarpVelocity(), 0.0
        self._override = False  # whether the zeros of `halt` are being published
        self._stopped = False  # whether a client that drives has to pause
        self._drives_until = 0.0  # when the client has paused, unless it sends another velocity before
        self._zeros = 0  # still to be published; not a time, because this process may be starved
        self._timer: Timer | None = None
        self._ended: Callable[[], None] | None = None
        self._ending = False

    @property
    def last(self) -> YarpVelocity | None:
        """The current command; None when its time is over."""
        return self._velocity if time.monotonic() <= self._until else None

    def command(self, velocity: YarpVelocity, seconds: float, *, planner_drives: bool = False) -> None:
        """Command a velocity for this time, at most `LONGEST_SECONDS`.

        Raises `RequestError` after `end`, after `stop_client` until the client has paused, and while the planner drives
        or another person drives manually.
        """
        if self._ending:
            raise RequestError("the gateway is shutting down")
        reason = self._stop_holds(velocity, seconds) or ("" if planner_drives else self._control.rival())
        if reason:
            self._log_refusal(reason)
            raise RequestError(reason)
        if planner_drives:
            raise RequestError("the planner drives; stop or suspend it first")
        self._begin(velocity, seconds)

    def _stop_holds(self, velocity: YarpVelocity, seconds: float) -> str:
        """Return why the client may not drive yet; "" if it may. Zeros count as a pause."""
        if not any(velocity):
            return ""
        now = time.monotonic()
        self._stopped = self._stopped and now <= self._drives_until
        self._drives_until = now + max(_limited(seconds), _PAUSE_SECONDS)
        return _STOPPED if self._stopped else ""

    def _log_refusal(self, reason: str) -> None:
        """Log a refusal, because YARP's reply cannot contain the reason; not again while the client repeats itself."""
        now = time.monotonic()
        if reason != self._refused or now - self._refused_at > _LOG_SECONDS:
            self._host.log.warning("a velocity of %s is refused: %s", CLIENT, reason)
        self._refused, self._refused_at = reason, now

    def _begin(self, velocity: YarpVelocity, seconds: float, *, override: bool = False) -> None:
        if any(velocity):
            self._control.begin(f"{CLIENT} ({self._host.name})")
        else:
            self._control.end()
        self._velocity, self._until = velocity, time.monotonic() + _limited(seconds)
        self._override = override
        if self._timer is None:
            self._timer = self._host.loop.every(_PERIOD, self._repeat)
        self._send(velocity)

    def stop(self) -> None:
        """End the command; a base that followed the command stops. Raises nothing: the caller stops the goals, too."""
        if self._until:
            self._until = 0.0
            try:
                self._send(YarpVelocity())
            except Exception:
                self._host.log.exception("zero velocity could not be published; it is repeated")
            self._control.end()

    def stop_client(self) -> None:
        """Stop for a person: a client that repeats its velocity must pause before it drives again."""
        self._stopped = True
        self.stop()

    def end(self, done: Callable[[], None]) -> None:
        """Stop, accept no further commands of clients, and call ``done`` after the last zero."""
        self._ending = True
        if self._timer is None:
            done()
        else:
            self._ended = done
            self.stop()

    def halt(self) -> None:
        """Command zero for `OVERRIDE_SECONDS`, to override any other source of velocities."""
        self._begin(YarpVelocity(), OVERRIDE_SECONDS, override=True)

    def _repeat(self) -> None:
        if self.last is not None and (self._override or not self._control.rival()):
            self._send(self._velocity)
        elif self._until:
            self.stop()
        elif self._zeros and not self._busy() and not self._control.rival():
            self._send(YarpVelocity())
        else:
            self._close()

    def _close(self) -> None:
        assert self._timer is not None
        self._timer.close()
        self._timer, self._zeros = None, 0
        ended, self._ended = self._ended, None
        if ended is not None:
            ended()

    def _send(self, velocity: YarpVelocity) -> None:
        self._zeros = _ZEROS if any(velocity) else max(0, self._zeros - 1)
        self._publisher.publish(velocity.x, velocity.y, math.radians(velocity.turn))


def _limited(seconds: float) -> float:
    return min(max(seconds, 0.0), LONGEST_SECONDS)


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
        self._stop = stop
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
        def command() -> None:
            velocity = YarpVelocity(x_vel, y_vel, theta_vel)
            self._commander.command(velocity, timeout, planner_drives=self._gateway.has_base)

        self._move(command, _FRESH_SECONDS)

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
