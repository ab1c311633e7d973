"""RobotGoto stands while the gateway requires it, even if the planner that drives it hangs."""

from __future__ import annotations

from bridge.config.sections.navigation import HOLD, HOLD_TYPE
from bridge.hub.wire.qos import LATCHED
from bridge.messages.actions import GoalState
from navigation.constraints import Constraints
from tests.navigation.robot_goto.deployed import Goto
from tests.support.wait import until

SLOW = Constraints(max_lin_speed=0.1).to_text()


def test_a_stop_that_the_planner_does_not_handle_stops_the_robot(place: Goto) -> None:
    robot = place.robot
    gateway = robot.loop.call(lambda: robot.node.publisher(HOLD, HOLD_TYPE, LATCHED))

    def hold(*, on: bool) -> None:
        robot.loop.call(lambda: gateway.publish({"data": on}))

    try:
        hold(on=False)
        until(lambda: not place.module._hold.held, "the gateway holds nothing", 20)
        sent = robot.send(2.0, 0.0, 0.0, SLOW)
        until(lambda: robot.x > 0.05, "the robot drives", 30)
        hold(on=True)
        until(lambda: robot.commands[-1] == (0.0, 0.0, 0.0), "the robot stops", 20)
        status, result = sent.end()
        assert status is GoalState.ABORTED
        assert "the planner has not canceled its goal" in result["error_msg"]

        robot.commands.clear()
        sent = robot.send(0.5, 0.0)  # the next goal may arrive before the end of the hold
        until(lambda: len(robot.commands) > 20, "the robot is commanded", 20)
        assert set(robot.commands) == {(0.0, 0.0, 0.0)}
        hold(on=False)
        assert sent.end()[0] is GoalState.SUCCEEDED
    finally:
        robot.loop.call(lambda: robot.node.release(gateway))
