"""What must have crossed, asked of what the real programs say they heard."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from bridge.demo import camera, topics

ROS1, ROS2, ZENOH, YARP = "ROS 1", "ROS 2", "zenoh", "YARP"
YARP_TEXT = "YARP text"
"""The YARP program once more, by lines of text."""

_MOVED = 0.4
"""Metres or radians that a drive moves the robot at least."""


@dataclass(frozen=True, slots=True)
class Check:
    """One promise and what became of it."""

    name: str
    source: str
    target: str
    topic: str
    expected: str
    seen: str
    ok: bool

    def as_dict(self) -> dict[str, Any]:
        """As it stands in the demo's JSON file."""
        values = asdict(self)
        return {"name": values.pop("name"), "from": values.pop("source"), "to": values.pop("target"), **values}


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive: who commanded what, and the robot's own word on its pose and velocity.

    Attributes:
        source: who drove.
        command: linear velocity in m/s and angular in rad/s.
        before: the robot's x, y and yaw.
        after: the same once the commander had fallen silent.
        received: commands that reached the robot.
        sent: commands that were sent.
        velocity: the robot's velocity after the silence.
        seen: whether the commander itself saw the pose change.
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
class Promise:
    """A topic that crosses: how many messages at least, and how each reads."""

    name: str
    topic: str
    least: int
    reads: str
    latched: bool = False


def promises(map_text: str) -> tuple[Promise, ...]:
    """What ROS 1's topics must give to each of the others."""
    image = f"{camera.WIDTH} x {camera.HEIGHT} rgb8, {3 * camera.WIDTH * camera.HEIGHT} bytes"
    return (
        Promise("laser scan", topics.SCAN, 20, f"{topics.BEAMS} ranges"),
        Promise("odometry", topics.ODOM, 40, "at "),
        Promise("transforms", topics.TF, 40, "odom to base_link"),
        Promise("camera image", topics.IMAGE, 8, image),
        Promise("greeting", topics.FROM_ROS1, 3, "from ROS 1"),
        Promise("map, joined late", topics.MAP, 1, map_text, latched=True),
        Promise("static transforms, joined late", topics.TF_STATIC, 1, ", ".join(topics.STATIC_FRAMES), latched=True),
    )


GREETINGS = (
    (ROS2, ROS1, topics.FROM_ROS2),
    (ROS2, ZENOH, topics.FROM_ROS2),
    (ZENOH, ROS1, topics.FROM_ZENOH),
    (ZENOH, ROS2, topics.FROM_ZENOH),
    (ROS2, YARP, topics.FROM_ROS2),
    (ZENOH, YARP, topics.FROM_ZENOH),
    (YARP, ROS1, topics.FROM_YARP),
    (YARP, ROS2, topics.FROM_YARP),
    (YARP, ZENOH, topics.FROM_YARP),
)


def evaluate(reports: Mapping[str, Mapping[str, Any]], drives: Sequence[Drive]) -> list[Check]:
    """All checks.

    Args:
        reports: the last report of each program, by who it is.
        drives: the drives that were done.
    """
    map_text = str(reports[ROS1].get("map") or "no map was published")
    checks = [
        _heard(promise, ROS1, target, reports[target])
        for promise in promises(map_text)
        for target in (ROS2, ZENOH, YARP)
    ]
    for source, target, topic in GREETINGS:
        checks.append(_heard(Promise("greeting", topic, 3, f"from {source}"), source, target, reports[target]))
    for source, topic in zip((ROS1, ROS2, ZENOH, YARP), topics.HELLOS, strict=True):
        checks.append(_not_echoed(source, topic, reports[source]))
    for source in (ROS2, ZENOH, YARP, YARP_TEXT):
        checks += _driven(source, next((d for d in drives if d.source == source), None))
    return checks


def _ear(report: Mapping[str, Any], topic: str) -> tuple[int, int, str]:
    heard = report.get("heard", {}).get(topic, {})
    return heard.get("count", 0), heard.get("repeated", 0), heard.get("detail", "")


def _heard(promise: Promise, source: str, target: str, report: Mapping[str, Any]) -> Check:
    count, repeated, detail = _ear(report, promise.topic)
    ok = count >= promise.least and repeated == 0 and promise.reads in detail
    seen = f"{count}: {detail}" if count else "nothing"
    if repeated:
        seen += f"; {repeated} of them twice"
    expected = f"the whole of it: {promise.reads}" if promise.latched else f"{promise.least} or more: {promise.reads}"
    return Check(promise.name, source, target, promise.topic, expected.rstrip(": "), seen, ok)


def _not_echoed(source: str, topic: str, report: Mapping[str, Any]) -> Check:
    count, repeated, _ = _ear(report, topic)
    seen = f"{repeated} of {count} came back"
    return Check("no echo", source, source, topic, "each of its own messages once", seen, count > 0 and repeated == 0)


def _driven(source: str, drive: Drive | None) -> list[Check]:
    if drive is None:
        return [Check("drive", source, ROS1, topics.CMD_VEL, "the robot moves", "no drive was done", ok=False)]
    linear, angular = drive.command
    moved = ((drive.after[0] - drive.before[0]) ** 2 + (drive.after[1] - drive.before[1]) ** 2) ** 0.5
    turned = drive.after[2] - drive.before[2]
    way = f"{linear:g} m/s" if linear else f"{angular:g} rad/s"
    far = (moved if linear else abs(turned)) >= _MOVED
    arrived = f"{drive.received} of {drive.sent} commands, moved {moved:.2f} m, turned {turned:+.2f} rad"
    at_rest = far and all(abs(v) < 1e-6 for v in drive.velocity)
    resting = (
        "it stands" if at_rest else f"at {drive.velocity[0]:.2f} m/s, {drive.velocity[1]:.2f} rad/s after {arrived}"
    )
    seen = "it does" if drive.seen else "it does not"
    return [
        Check("drive", source, ROS1, topics.CMD_VEL, f"the robot moves at {way}", arrived, far),
        Check("drive seen", ROS1, source, topics.ODOM, "its driver sees the robot move", seen, drive.seen),
        Check("silence stops it", source, ROS1, topics.CMD_VEL, "no command, no motion", resting, at_rest),
    ]
