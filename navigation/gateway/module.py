"""The gateway: clients of every side give goals, the chosen planner drives; see docs/navigation/navigation.md."""

from __future__ import annotations

from typing import Any

from bridge.config.sections.navigation import ACTION, GOAL_POSE, HOLD, HOLD_TYPE, NavigationSection
from bridge.config.sections.section import Section
from bridge.hub.errors import HubError
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.worker import Health
from navigation.frames import RobotFrames
from navigation.gateway.drive import StoredPlaces, TargetError, target_of
from navigation.gateway.gateway import BETWEEN_MAPS, Gateway
from navigation.gateway.planner_link import POSE
from navigation.gateway.services import WHO, GatewayDevice, HubServices, VelocityCommander, YarpVelocity
from navigation.gateway.stop import StopAnswer, waited_for
from navigation.goals import CUT_OFF, FarClients
from navigation.messages import NAVIGATE
from navigation.status import STATUS, Fault, State
from yarp_compat.dev.inavigation2d import Navigation2DServer

STATUS_TOPIC = "/navigation/status"
_AGAIN_SECONDS = 5.0  # after so long YARP's ports say the status again, as YARP's own do
_CHANGEABLE = ("planner", "planners", "localizer", "map", "patience", "silence")


class GatewayModule(Module):
    """Serves the gateway on the hub and on YARP."""

    name = "gateway"

    def start(self, host: Host, section: Section) -> None:
        """Open all topics, services and ports."""
        assert isinstance(section, NavigationSection)
        self._host, self._section = host, section
        self._told = host.node.publisher(STATUS_TOPIC, STATUS, LATCHED, priority="state")
        self._state = State.IDLE.value
        self._ports = [host.yarp.output(f"{door}/status:o") for door in section.doors.yarp]
        frames = RobotFrames(host, section.frame, section.base_frame)
        self._commander = VelocityCommander(host, section.velocity)
        self._holding = host.node.publisher(HOLD, HOLD_TYPE, LATCHED, priority="state")
        self._holding.publish({"data": False})
        self.gateway = Gateway(host, section, frames, self._tell, self._hold)
        places = StoredPlaces(host, section.frame, lambda: self.gateway.planner == BETWEEN_MAPS)
        server = host.node.action_server(ACTION, NAVIGATE, self.gateway.take, self.gateway.cancel)
        FarClients(host, server, lambda goal: self.gateway.lost(goal, CUT_OFF))
        host.node.subscription(GOAL_POSE, POSE, self._goal_pose, Qos(depth=1))
        HubServices(host.node, self.gateway, places, self._commander)
        self._answers = Navigation2DServer(GatewayDevice(host, self.gateway, places, self._commander, self._begin_stop))
        for door in section.doors.yarp:
            host.yarp.serve(f"{door}/rpc", self._answers)
        host.answer("halt", self.halt)
        self._tell(self.gateway.status())
        host.loop.every(_AGAIN_SECONDS, self._say)

    def reload(self, section: Section) -> bool:
        """Take up another planner, once the one that drives stands; other doors are opened by a new start."""
        assert isinstance(section, NavigationSection)
        same = {name: getattr(section, name) for name in _CHANGEABLE}
        if self._section.model_copy(update=same) != section:
            return False
        self._section = section
        self.gateway.configure(section)
        return True

    def halt(self, _params: Any = None) -> dict[str, Any]:
        """Give up every goal, also a paused one; on any thread. Raises `HubError` unless the robot surely stands."""
        trouble = waited_for(self._host.loop.call(self._begin_stop))
        if trouble:
            raise HubError(trouble)
        return {"halted": True}

    def _begin_stop(self) -> StopAnswer:
        self._commander.stop()
        self.gateway.stop()
        answer = StopAnswer()
        self.gateway.when_stopped(answer.put)
        return answer

    def _hold(self, held: bool) -> None:
        self._holding.publish({"data": held})
        if held:
            self._commander.halt()
        elif self._commander.last == YarpVelocity():
            self._commander.stop()

    def _goal_pose(self, message: dict[str, Any]) -> None:
        try:
            self.gateway.begin([target_of(message)], f"who publishes {GOAL_POSE}")
        except TargetError as err:
            self.gateway.ended["refused"] += 1
            self._host.log.warning("%s: refused: %s", GOAL_POSE, err)

    def _tell(self, status: dict[str, Any]) -> None:
        self._told.publish(status)
        self._state = status["state"]
        drive = self.gateway.drive
        if drive is None and self.gateway.driving:
            self._answers.target_name = ""
        elif drive is not None and drive.who != WHO:
            self._answers.target_name = drive.name
        if self.gateway.has_base and not self.gateway.held:
            self._commander.stop()
        self._say()

    def _say(self) -> None:
        for port in self._ports:
            port.write([f"navigation_status_{self._state}"])

    def health(self) -> Health:
        """Which planner there is, and what it does."""
        gateway = self.gateway
        if not gateway.link.ready:
            return Health("waiting", f"the planner {gateway.planner} is not there")
        state, why, code = gateway.state()
        if code in (Fault.SILENT, Fault.MAY_MOVE):
            return Health("waiting", why)
        words = f"{gateway.planner} {state.value.replace('_', ' ')}" + (f" ({why})" if why else "")
        return Health("running", f"{words}; {gateway.pending} once it stands" if gateway.pending else words)

    def status(self) -> dict[str, Any]:
        """What drives to where."""
        gateway = self.gateway
        state, why, _ = gateway.state()
        drive = gateway.drive
        return {
            "planner": gateway.planner,
            "planners": list(gateway.choices),
            "pending": gateway.pending,
            "navigation": state.value,
            "reason": why,
            "goals": 0 if drive is None else len(drive.targets) - drive.at,
            "goal": None if drive is None else [*drive.target.pose[:3]],
            "client": "" if drive is None else drive.who,
            "goals_of_others": len(gateway.link.others),
            "goals_ended": dict(gateway.ended),
        }

    def stop(self) -> None:
        """Give up what is under way."""
        self._commander.stop()
        self.gateway.close()
