"""The module that bridges YARP control boards: a `JointState` topic for each, and optionally a command topic."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.boards.link import BoardLink, Joints
from bridge.boards.section import JOINTS, ControlBoardSection, ControlBoardsSection
from bridge.config.sections.section import Section
from bridge.hub.wire.qos import Qos, Reliability
from bridge.module_keys import BoardKeys, BoardStatus
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.routing.stall import AgeGate, StallDetector
from bridge.worker import Health
from yarp_compat.dev.controlboard.streams import JointData

_NEWEST = Qos(Reliability.BEST_EFFORT, depth=1)
_MAX_COMMANDERS = 32  # commanders whose clocks are followed
_HALT_SECONDS = 2.0  # time limit of a halt


class ControlBoards(Module):
    """Connects the boards of the configuration section."""

    name = "control_boards"

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, ControlBoardsSection)
        self._host = host
        self._stall = StallDetector()
        self._stall.start()
        self._links: list[BoardLink] = []
        self.refused: dict[str, str] = {}
        for board in section.boards:
            prefix = f"/{host.config.name}/boards{board.remote}"
            link = BoardLink(board, prefix, host.yarp.naming, self._state_publisher(board))
            if board.command:
                self._subscribe(board, link)
            self._links.append(link)
            link.start()
        host.answer("halt", lambda _params: self._halt())

    @override
    def health(self) -> Health:
        trouble = next((link.trouble for link in self._links if link.trouble), "")
        return Health("waiting", trouble) if trouble else Health("running", f"{len(self._links)} boards")

    @override
    def status(self) -> BoardKeys:
        return BoardKeys(
            boards=[
                BoardStatus(
                    board=link.remote,
                    joints=list(link.joints.names) if link.joints is not None else [],
                    trouble=link.trouble,
                    states=link.states,
                    dropped_commands=link.dropped,
                )
                for link in self._links
            ],
            refused=dict(self.refused),
        )

    @override
    def stop(self) -> None:
        """Stop the moving joints, and disconnect."""
        for link in self._links:
            link.stop()
        self._stall.stop()

    def _halt(self) -> dict[str, Any]:
        """Halt all boards at the same time; raises `TimeoutError` if one does not confirm that."""
        begun = [(link, link.begin_halt()) for link in self._links]
        end = time.monotonic() + _HALT_SECONDS
        troubles = [trouble or link.await_halt(max(end - time.monotonic(), 0.0)) for link, trouble in begun]
        if any(troubles):
            raise TimeoutError("; ".join(filter(None, troubles)))
        return {"halted": True}

    def _state_publisher(self, board: ControlBoardSection) -> Callable[[Joints, JointData, float], None]:
        """Return a function that publishes the states of a board; it runs on the connection's thread."""
        publisher = self._host.node.publisher(board.joint_states, JOINTS, Qos(depth=10))
        clock = self._host.clock

        def publish(joints: Joints, data: JointData, seconds: float) -> None:
            now = clock.stamp() if clock.simulated else _stamp(seconds)
            publisher.offer(lambda: publisher.encoded(joint_state(joints, data, now)))

        return publish

    def _subscribe(self, board: ControlBoardSection, link: BoardLink) -> None:
        ages: dict[bytes, AgeGate] = {}

        def on_command(message: dict[str, Any]) -> None:
            if len(ages) >= _MAX_COMMANDERS and subscription.sender not in ages:
                del ages[next(iter(ages))]
            age = ages.setdefault(subscription.sender, AgeGate()).age(subscription.sent_ns)
            stale = age > board.timeout or self._stall.stood_still(board.timeout)
            if stale and not _stops(message):
                subscription.counters.dropped("stale")
                return
            problem = link.command(message["velocity"], message["position"], message["name"])
            if problem:
                subscription.counters.dropped("bad")
                if self.refused.get(board.command) != problem:
                    self._host.log.warning("%s: command refused: %s", board.command, problem)
            self.refused[board.command] = problem

        subscription = self._host.node.subscription(board.command, JOINTS, on_command, _NEWEST)


def _stops(message: dict[str, Any]) -> bool:
    """Return whether a command only stops joints, however late it is."""
    return len(message["velocity"]) > 0 and not np.any(message["velocity"])


def joint_state(joints: Joints, data: JointData, stamp: dict[str, int]) -> dict[str, Any]:
    """Return the valid fields of a board's state in the hub's units: radians and radians per second, or meters."""
    scales = np.array(joints.scales)
    message: dict[str, Any] = {"header": {"stamp": stamp, "frame_id": ""}, "name": list(joints.names)}
    for field, name, scale in (
        ("position", "jointPosition", scales),
        ("velocity", "jointVelocity", scales),
        ("effort", "torque", 1.0),
    ):
        values = data.values.get(name)
        if values is not None:
            message[field] = values * scale
    return message


def _stamp(seconds: float) -> dict[str, int]:
    whole, nanoseconds = divmod(round(seconds * 1e9), 1_000_000_000)
    return {"sec": whole, "nanosec": nanoseconds}
