"""Constraints on the drive to a goal, which a planner sends to a local navigator with each waypoint.

On the hub they are in the ``behavior_tree`` text of a ``nav2_msgs/action/NavigateToPose`` goal, for example
``midspan: max_lin_speed=0.2 on_obstacle=wait through=true``. Only Midspan's planners receive them: for other servers,
such as Nav2's, that text is the name of a behavior tree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any
from urllib.parse import quote, unquote

PREFIX = "midspan:"
ON_OBSTACLE = ("", "wait", "around")
_BOOLEANS = {"true": True, "false": False}


@dataclass(frozen=True)
class Constraints:
    """Constraints for one goal; None or "" means the navigator's own setting. Raises `ValueError` if one is invalid."""

    max_lin_speed: float | None = None  #: m/s
    min_lin_speed: float | None = None  #: m/s
    max_ang_speed: float | None = None  #: deg/s
    min_ang_speed: float | None = None  #: deg/s
    lin_speed_gain: float | None = None  #: (m/s) / m
    ang_speed_gain: float | None = None  #: (deg/s) / deg
    tolerance_lin: float | None = None  #: m
    tolerance_ang: float | None = None  #: degrees
    on_obstacle: str = ""  #: ``wait`` until the obstacle moves away, or drive ``around`` it
    beside_keep_out: str = ""  #: map whose keep-out cells are near; a navigator without that map always waits
    heading: bool = True  #: whether the goal's heading matters
    through: bool = False  #: whether the robot passes without a stop, as at a waypoint
    map: str = ""  #: the goal's map, if it is not the current one

    def __post_init__(self) -> None:
        for name in _NUMBERS:
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be a number of at least 0, not {value}")
        if self.on_obstacle not in ON_OBSTACLE:
            raise ValueError(f"on_obstacle must be 'wait' or 'around', not '{self.on_obstacle}'")
        if len(self.map.split()) > 1:
            raise ValueError(f"a map's name must not have spaces: '{self.map}'")

    def to_text(self) -> str:
        """Return the constraints as text; empty if there are none."""
        values = {name: value for name, value in vars(self).items() if value != getattr(_NOTHING, name)}
        settings = [f"{name}={_text(name, value)}" for name, value in values.items()]
        return " ".join((PREFIX, *settings)) if settings else ""

    @classmethod
    def from_text(cls, text: str) -> Constraints:
        """Parse a goal's text; texts of another kind have no constraints. Raises `ValueError` if invalid."""
        if not text.startswith(PREFIX):
            return cls()
        given: dict[str, Any] = {}
        for part in text[len(PREFIX) :].split():
            name, _, value = part.partition("=")
            if name not in _NAMES:
                raise ValueError(f"unknown constraint '{name}'; use {', '.join(_NAMES)}")
            given[name] = _parse(name, value)
        return cls(**given)


def _text(name: str, value: Any) -> str:
    if name == "beside_keep_out":
        return quote(value, safe="")  # a map's name may have spaces
    return str(value).lower() if isinstance(value, bool) else str(value)


def _parse(name: str, text: str) -> Any:
    if name == "beside_keep_out":
        return unquote(text)
    if name in ("on_obstacle", "map"):
        return text
    if name not in _NUMBERS:
        if text not in _BOOLEANS:
            raise ValueError(f"{name} must be true or false, not '{text}'")
        return _BOOLEANS[text]
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name} must be a number, not '{text}'") from None


_NAMES = tuple(field.name for field in fields(Constraints))
_NUMBERS = _NAMES[:8]
_NOTHING = Constraints()
