"""The rules that follow from the section ``navigation``: who is which planner, and which doors the gateway has."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bridge.config.sections.navigation import ACTION, GOAL_POSE, NavigationSection
from bridge.config.sections.routing import RoutingSection, Rule

TWIST, POSE = "geometry_msgs/msg/Twist", "geometry_msgs/msg/PoseStamped"
PATH, GRID = "nav_msgs/msg/Path", "nav_msgs/msg/OccupancyGrid"


class MadeRule(Rule):
    """A rule that stands in no file.

    Attributes:
        of: what it follows from, for people.
    """

    of: str


def with_navigation(routing: RoutingSection, navigation: NavigationSection) -> RoutingSection:
    """The rules of the file, after those that follow from ``navigation``; a ``deny`` of either wins.

    What planners tell besides comes last: where the file limits its rate, so it is.
    """
    if not navigation.planner:
        return routing
    rules = *made_rules(navigation), *routing.rules, *_told(navigation)
    return routing.model_copy(update={"rules": rules})


def made_rules(section: NavigationSection) -> Iterator[MadeRule]:
    """The rules of a section that names a planner."""
    doors = section.doors
    for planner in section.others.values():
        of = f"navigation (planner {planner.name})"
        if planner.side != "zenoh":
            yield _rule(of, kind="action", topic=planner.action, from_=planner.side, rename=planner.on_hub)
        if planner.velocity and planner.velocity != section.velocity:
            yield _rule(
                of, kind="topic", topic=planner.velocity, type=TWIST, from_=planner.side, rename=section.velocity,
                priority="command",
            )  # fmt: skip
    taken: dict[tuple[str, str], str] = {
        (planner.side, planner.action): planner.name for planner in section.others.values()
    }
    for side, action, goal in (("ros1", doors.ros1, doors.ros1_goal), ("ros2", doors.ros2, doors.ros2_goal)):
        yield from _door(side, action, goal, taken.get((side, action), ""))
    yield _rule("navigation", topic="/navigation/**")
    yield _rule("navigation.velocity", kind="topic", topic=section.velocity, type=TWIST, priority="command")


def _told(section: NavigationSection) -> Iterator[MadeRule]:
    """The rules of the topics on which planners tell their ways, local maps and goals."""
    for planner in section.others.values():
        told = (planner.path, PATH), (planner.local_map, GRID), (planner.current_goal, POSE)
        for topic, kind in told:
            if topic and planner.side != "zenoh":
                yield _rule(
                    f"navigation (planner {planner.name})", kind="topic", topic=topic, type=kind, from_=planner.side
                )


def _door(side: str, action: str, goal: str, owner: str) -> Iterator[MadeRule]:
    """The rules of one side's door; where a planner has its name, what is said there is the planner's alone."""
    of = f"navigation ({owner} has {action} there itself)" if owner else f"navigation.doors.{side}"
    if owner or not action:
        yield _rule(of, kind="action", topic=ACTION, to=side, deny=True)
    else:
        yield _rule(of, kind="action", topic=ACTION, to=side, rename=action)
    if not goal:
        return
    if owner:  # the planner hears it there; what others say there must not reach it either
        yield _rule(of, kind="topic", topic=goal, type=POSE, from_=side, to="zenoh", deny=True)
        yield _rule(of, kind="topic", topic=goal, type=POSE, to=side, deny=True)
    else:
        yield _rule(of, kind="topic", topic=goal, type=POSE, from_=side, rename=GOAL_POSE)


def _rule(of: str, **values: Any) -> MadeRule:
    return MadeRule.model_validate({"of": of, **values})
