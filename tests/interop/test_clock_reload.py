"""A reload changes `clock.source`, with a real master; simulated time without a publisher of `/clock` is reported."""

from __future__ import annotations

from tests.peers.daemon.deployment import Deployment
from tests.support.wait import until

CLOCK, NOBODY = "rosgraph_msgs/Clock", "no message on /clock"


def simulated(running: Deployment) -> bool:
    """Return whether the ROS 1 worker has joined with simulated time, and has set the parameter on the master."""
    joined = running.worker("ros1").get("state") == "running"
    return joined and any(name == "/use_sim_time" for name in running.master.parameters())


def restarted(running: Deployment, before: dict[str, int]) -> bool:
    """Return whether all sides have joined in other processes than before; a side may be the last to stop."""
    joined = {d["side"]: d["pid"] for d in running.status() if d.get("side") in before and d["state"] == "running"}
    return all(joined.get(side) not in (None, pid) for side, pid in before.items())


def test_simulated_time_begins_and_ends_by_a_reload(running: Deployment) -> None:
    before = {side: running.answer(side)["pid"] for side in ("ros1", "ros2")}
    assert not simulated(running)
    running.configure(clock={"source": "sim"})
    running.hang_up()
    until(lambda: simulated(running), "the master has /use_sim_time", 40, every=0.1)
    until(lambda: restarted(running, before), "every worker was restarted, to use the new clock", 40, every=0.1)
    after = {side: running.answer(side)["pid"] for side in before}

    until(
        lambda: all(NOBODY in str(running.worker(side).get("warnings")) for side in before),
        "the status of every side has the warning",
        20,
        every=0.2,
    )
    # a busy worker may not respond to a command in time
    until(lambda: NOBODY in running.command("status", seconds=60).stdout, "midspan status has the warning", 40)

    def diagnosed() -> bool:
        printed = running.command("doctor", "--only", "daemon", "--only", "clock", seconds=90).stdout
        return NOBODY in printed and "/clock has no publisher" in printed

    until(diagnosed, "midspan doctor has the warning, and names the missing publisher", 40)

    ros1 = running.ros1("simulator")
    out = ros1.advertise("/clock", CLOCK)
    until(
        lambda: (
            ros1.publish(out, {"clock": {"secs": 7, "nsecs": 0}}),
            not any("/clock" in str(running.worker(side).get("warnings")) for side in before),
        )[1],
        "no worker warns while time runs",
        20,
        every=0.2,
    )
    until(
        lambda: "/clock is silent" in str(running.worker("ros2").get("warnings")),
        "the clock's silence is reported",
        20,
        every=0.2,
    )

    running.configure()
    running.hang_up()
    until(lambda: restarted(running, after), "workers restart", 40, every=0.1)
    assert "/use_sim_time" not in running.master.parameters(), "Midspan takes back what it has set"
    assert running.ros1("late").ask("now")["seconds"] > 0, "a program that starts now runs on the system clock"
    for side in before:
        assert "/clock" not in str(running.answer(side)["warnings"])

    running.ros1("operator").ask("set_param", name="/use_sim_time", value=True)
    cure = "set clock.source to sim, or the parameter to false"
    until(lambda: cure in str(running.worker("ros1").get("warnings")), "the status of ros1 has the cure", 20, every=0.1)
    before = {"ros1": running.answer("ros1")["pid"]}
    running.configure(clock={"source": "sim"})
    running.hang_up()
    until(lambda: restarted(running, before), "the side joins again", 40, every=0.1)
    assert running.stop_daemon() == 0
    assert running.master.call("getParam", "/use_sim_time") is True, "the operator's value stays"
