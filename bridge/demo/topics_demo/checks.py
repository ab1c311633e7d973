"""Checks of what must have been bridged, from the reports of the real programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from bridge.demo.topics_demo import messages

ROS1, ROS2, ZENOH, YARP = "ROS 1", "ROS 2", "zenoh", "YARP"
YARP_TEXT = "YARP text"
"""The YARP program when it sends lines of text."""

_MOVED = 0.4
"""Minimum motion of a drive in meters or radians."""


@dataclass(frozen=True, slots=True)
class CrossingCheck:
    """One check with its result."""

    name: str
    source: str
    target: str
    topic: str
    expected: str
    seen: str
    ok: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the entry for the demo's JSON file."""
        values = asdict(self)
        return {"name": values.pop("name"), "from": values.pop("source"), "to": values.pop("target"), **values}


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive: its command (m/s, rad/s), the robot's x, y, yaw before and after, and its velocity at the end.

    ``received`` of ``sent`` commands reached the robot; ``seen``: the driver saw the pose change.
    """

    source: str
    command: tuple[float, float]
    before: Sequence[float]
    after: Sequence[float]
    received: int
    sent: int
    velocity: Sequence[float]
    seen: bool


@dataclass(frozen=True, slots=True)
class Expectation:
    """What a bridged topic must deliver: the minimum number of messages, and a text in the last one's description."""

    name: str
    topic: str
    least: int
    reads: str
    latched: bool = False


def expectations(map_text: str, image: str) -> tuple[Expectation, ...]:
    """Return what each other side must receive of ROS 1's topics, given the robot's descriptions of map and image."""
    return (
        Expectation("laser scan", messages.SCAN, 20, f"{messages.BEAMS} ranges"),
        Expectation("odometry", messages.ODOM, 40, "at "),
        Expectation("transforms", messages.TF, 40, "odom to base_link"),
        Expectation("camera image", messages.IMAGE, 8, image),
        Expectation("greeting", messages.FROM_ROS1, 3, "from ROS 1"),
        Expectation("map, joined late", messages.MAP, 1, map_text, latched=True),
        Expectation(
            "static transforms, joined late", messages.TF_STATIC, 1, ", ".join(messages.STATIC_FRAMES), latched=True
        ),
    )


GREETINGS = (
    (ROS2, ROS1, messages.FROM_ROS2),
    (ROS2, ZENOH, messages.FROM_ROS2),
    (ZENOH, ROS1, messages.FROM_ZENOH),
    (ZENOH, ROS2, messages.FROM_ZENOH),
    (ROS2, YARP, messages.FROM_ROS2),
    (ZENOH, YARP, messages.FROM_ZENOH),
    (YARP, ROS1, messages.FROM_YARP),
    (YARP, ROS2, messages.FROM_YARP),
    (YARP, ZENOH, messages.FROM_YARP),
)


def evaluate(reports: Mapping[str, Mapping[str, Any]], drives: Sequence[Drive]) -> list[CrossingCheck]:
    """Return all checks, from each program's last report and the drives."""
    map_text, image = (str(reports[ROS1].get(kind) or f"no {kind} was published") for kind in ("map", "image"))
    checks = [
        _check_received(promise, ROS1, target, reports[target])
        for promise in expectations(map_text, image)
        for target in (ROS2, ZENOH, YARP)
    ]
    for source, target, topic in GREETINGS:
        checks.append(
            _check_received(Expectation("greeting", topic, 3, f"from {source}"), source, target, reports[target])
        )
    for source, topic in zip((ROS1, ROS2, ZENOH, YARP), messages.HELLOS, strict=True):
        checks.append(_check_no_echo(source, topic, reports[source]))
    for source in (ROS2, ZENOH, YARP, YARP_TEXT):
        checks += _check_drive(source, next((d for d in drives if d.source == source), None))
    return checks


def _received(report: Mapping[str, Any], topic: str) -> tuple[int, int, str]:
    topic_report = report.get("heard", {}).get(topic, {})
    return topic_report.get("count", 0), topic_report.get("repeated", 0), topic_report.get("detail", "")


def _check_received(expectation: Expectation, source: str, target: str, report: Mapping[str, Any]) -> CrossingCheck:
    count, repeated, detail = _received(report, expectation.topic)
    ok = count >= expectation.least and repeated == 0 and expectation.reads in detail
    seen = f"{count}: {detail}" if count else "nothing"
    if repeated:
        seen += f"; {repeated} of them twice"
    expected = (
        f"complete: {expectation.reads}" if expectation.latched else f"{expectation.least} or more: {expectation.reads}"
    )
    return CrossingCheck(expectation.name, source, target, expectation.topic, expected.rstrip(": "), seen, ok)


def _check_no_echo(source: str, topic: str, report: Mapping[str, Any]) -> CrossingCheck:
    count, repeated, _ = _received(report, topic)
    seen = f"{repeated} of {count} came back"
    return CrossingCheck("no echo", source, source, topic, "its own messages once", seen, count > 0 and repeated == 0)


def _check_drive(source: str, drive: Drive | None) -> list[CrossingCheck]:
    if drive is None:
        return [
            CrossingCheck("drive", source, ROS1, messages.CMD_VEL, "the robot moves", "there was no drive", ok=False)
        ]
    linear, angular = drive.command
    moved = ((drive.after[0] - drive.before[0]) ** 2 + (drive.after[1] - drive.before[1]) ** 2) ** 0.5
    turned = drive.after[2] - drive.before[2]
    velocity = f"{linear:g} m/s" if linear else f"{angular:g} rad/s"
    far = (moved if linear else abs(turned)) >= _MOVED
    arrived = f"{drive.received} of {drive.sent} commands, moved {moved:.2f} m, turned {turned:+.2f} rad"
    at_rest = far and all(abs(v) < 1e-6 for v in drive.velocity)
    resting = "stopped" if at_rest else f"at {drive.velocity[0]:.2f} m/s, {drive.velocity[1]:.2f} rad/s after {arrived}"
    seen = "yes" if drive.seen else "no"
    return [
        CrossingCheck("drive", source, ROS1, messages.CMD_VEL, f"the robot moves at {velocity}", arrived, far),
        CrossingCheck("drive seen", ROS1, source, messages.ODOM, "its driver observes the motion", seen, drive.seen),
        CrossingCheck("timeout stops it", source, ROS1, messages.CMD_VEL, "no command, no motion", resting, at_rest),
    ]
