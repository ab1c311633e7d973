"""The gateway's module: its action, topics, services and ports; see docs/navigation/navigation.md."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from typing_extensions import override

from bridge.config.sections.navigation import (
    ACTION,
    GOAL_POSE,
    HOLD,
    HOLD_TYPE,
    THROUGH_POSES,
    NavigationSection,
)
from bridge.config.sections.section import Section
from bridge.hub.errors import HubError
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.module_keys import GatewayKeys
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.worker import Health
from navigation import lifecycle
from navigation.frames import RobotFrames
from navigation.gateway.entry import NavigateAction
from navigation.gateway.gateway import BETWEEN_MAPS, Gateway
from navigation.gateway.services import GatewayDevice, HubServices
from navigation.gateway.stop import StopAnswer, wait_for
from navigation.gateway.targets import StoredPlaces, TargetError, target_of
from navigation.gateway.telemetry import POSE
from navigation.gateway.velocities import CLIENT, VelocityCommander, YarpVelocity
from navigation.goals import FarClients
from navigation.messages import THROUGH
from navigation.status import STATUS, Fault, State
from yarp_compat.dev.inavigation2d import Navigation2DServer

STATUS_TOPIC = "/navigation/status"
_REPEAT_SECONDS = 5.0  # the YARP ports repeat the status after this time, like those of YARP's own servers
_CHANGEABLE = ("planner", "planners", "localizer", "map", "patience", "silence")


class GatewayModule(Module):
    """Serves the gateway on the hub and on YARP."""

    name = "gateway"

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, NavigationSection)
        self._host, self._section = host, section
        self._status = host.node.publisher(STATUS_TOPIC, STATUS, LATCHED, priority="state")
        self._state = State.IDLE.value
        self._ports = [host.yarp.output(f"{prefix}/status:o") for prefix in section.doors.yarp]
        frames = RobotFrames(host, section.frame, section.base_frame)
        self._commander = VelocityCommander(host, section.velocity, lambda: self._planner_drives)
        self._holding = host.node.publisher(HOLD, HOLD_TYPE, LATCHED, priority="state")
        self._holding.publish({"data": False})
        self.gateway = Gateway(host, section, frames, self._on_status, self._hold)
        places = StoredPlaces(host, section.frame, lambda: self.gateway.planner == BETWEEN_MAPS)
        gateway = self.gateway
        self._action = NavigateAction(
            host, lambda: gateway.planner_has_action, gateway.accept_goal, gateway.cancel_goal, gateway.client_lost
        )
        poses = host.node.action_server(THROUGH_POSES, THROUGH, gateway.accept_goal, gateway.cancel_goal)
        FarClients(host, poses, gateway.client_lost)
        host.node.subscription(GOAL_POSE, POSE, self._on_goal_pose, Qos(depth=1))
        HubServices(host.node, gateway, places, self._commander)
        self._device = Navigation2DServer(GatewayDevice(host, gateway, places, self._commander, self._begin_stop))
        for prefix in section.doors.yarp:
            host.yarp.serve(f"{prefix}/rpc", self._device)
        host.answer("halt", self.halt)
        self._on_status(gateway.status())
        host.loop.every(_REPEAT_SECONDS, self._write_status)

    @override
    def reload(self, section: Section) -> bool:
        """Apply changes of `_CHANGEABLE`; another planner takes over as soon as the robot stands still.

        Other changes need a restart.
        """
        assert isinstance(section, NavigationSection)
        same = {name: getattr(section, name) for name in _CHANGEABLE}
        if self._section.model_copy(update=same) != section:
            return False
        self._section = section
        self.gateway.configure(section)
        return True

    @override
    def on_failure(self, error: BaseException) -> bool:
        """Keep the goals: the planner executes them, and the next poll, 0.1 s later, follows them again."""
        return True

    def halt(self, _params: Any = None) -> dict[str, Any]:
        """Cancel every goal, even a paused one; may be called on any thread.

        Raises `HubError` unless the robot is known to stand still.
        """
        trouble = wait_for(self._host.loop.call(self._begin_stop))
        if trouble:
            raise HubError(trouble)
        return {"halted": True}

    def _begin_stop(self) -> StopAnswer:
        self._commander.stop_client()
        self.gateway.stop()
        answer = StopAnswer()
        self.gateway.when_confirmed(answer.put)
        return answer

    def _hold(self, held: bool) -> None:
        self._holding.publish({"data": held})
        if held:
            self._commander.halt()
        elif self._commander.last == YarpVelocity():
            self._commander.stop()

    def _on_goal_pose(self, message: dict[str, Any]) -> None:
        if self._action.planner_receives(GOAL_POSE):  # it executes the goal, and the gateway follows its goal list
            return
        try:
            self.gateway.execution.begin([target_of(message)], f"a publisher of {GOAL_POSE}")
        except TargetError as err:
            self.gateway.ended["refused"] += 1
            self._host.log.warning("%s: refused: %s", GOAL_POSE, err)

    def _on_status(self, status: dict[str, Any]) -> None:
        self._status.publish(status)
        self._state = status["state"]
        drive = self.gateway.drive
        if drive is None and self.gateway.driving:
            self._device.target_name = ""
        elif drive is not None and drive.client != CLIENT:
            self._device.target_name = drive.name
        if self._planner_drives:
            self._commander.displace()
        self._write_status()

    @property
    def _planner_drives(self) -> bool:
        return self.gateway.has_base and not self.gateway.held

    def _write_status(self) -> None:
        for port in self._ports:
            port.write([f"navigation_status_{self._state}"])

    @override
    def health(self) -> Health:
        gateway = self.gateway
        if not gateway.link.reachable:
            inactive = lifecycle.trouble(gateway.link.lifecycle.inactive)
            why = f": {inactive}" if inactive else ""
            return Health("waiting", f"the planner {gateway.planner} is not available{why}")
        state, reason, code = gateway.state()
        if code in (Fault.SILENT, Fault.MAY_MOVE):
            return Health("waiting", reason)
        text = f"{gateway.planner} {state.value.replace('_', ' ')}" + (f" ({reason})" if reason else "")
        if gateway.pending:
            text += f"; {gateway.pending} takes over when the robot stands still"
        if self._action.served_by:
            text += f"; {ACTION} is served by {self._action.served_by}"
        return Health("running", text)

    @override
    def status(self) -> GatewayKeys:
        gateway = self.gateway
        state, reason, _ = gateway.state()
        drive, other = gateway.drive, self._action.served_by
        return GatewayKeys(
            planner=gateway.planner,
            planners=list(gateway.choices),
            pending=gateway.pending,
            navigation=state.value,
            reason=reason,
            goals=0 if drive is None else len(drive.targets) - drive.at,
            goal=None if drive is None else [*drive.target.pose[:3]],
            client="" if drive is None else drive.client,
            goals_of_others=len(gateway.link.foreign),
            goals_ended=dict(gateway.ended),
            served_by=other,
            inactive_nodes=gateway.link.lifecycle.inactive,
        )

    @override
    def warnings(self) -> Iterable[str]:
        other, inactive = self._action.served_by, self.gateway.link.lifecycle.inactive
        if other:
            yield f"{ACTION} is served by {other}: {_BESIDE}"
        if inactive:
            yield f"{lifecycle.trouble(inactive)}; {lifecycle.cure(inactive)}"

    @override
    def begin_stop(self, done: Callable[[], None]) -> None:
        """Stop the robot if the gateway moves it, before clients lose the server of their goals."""
        self._commander.stop()
        self.gateway.shut_down(lambda: self._commander.end(done))

    @override
    def stop(self) -> None:
        self._commander.stop()
        self.gateway.close()


_BESIDE = (
    "its clients on the hub and on ROS 2 reach that node directly, and the gateway serves YARP and its other entry"
    " points; stop that node, or name it as planner (nav2_zenoh: Nav2 on rmw_zenoh), so that the robot has one master"
)
