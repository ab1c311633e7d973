"""How a goal is to be driven to: what a planner asks of a local navigator with each waypoint.

On the hub they go in the ``behavior_tree`` text of a ``nav2_msgs/action/NavigateToPose`` goal, which only Nav2 itself
reads otherwise: ``midspan: max_lin_speed=0.2 on_obstacle=wait through=true``. Servers that are not ours get it empty.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

PREFIX = "midspan:"
ON_OBSTACLE = ("", "wait", "around")
_WORDS = {"true": True, "false": False}


@dataclass(frozen=True)
class Constraints:
    """What holds for one goal, None or  meaning the navigator's own; raises `ValueError` if a value cannot be."""

    max_lin_speed: float | None = None  #: m/s
    min_lin_speed: float | None = None  #: m/s
    max_ang_speed: float | None = None  #: deg/s
    min_ang_speed: float | None = None  #: deg/s
    lin_speed_gain: float | None = None  #: (m/s) / m
    ang_speed_gain: float | None = None  #: (deg/s) / deg
    tolerance_lin: float | None = None  #: m
    tolerance_ang: float | None = None  #: degrees
    on_obstacle: str = ""  #: ``wait`` until it is gone, or go ``around`` it
    heading: bool = True  #: whether the goal's heading matters; with False any will do
    through: bool = False  #: whether it is a waypoint, passed without a stop
    map: str = ""  #: the goal's map, where it is not the one that the planner is on

    def __post_init__(self) -> None:
        for name in _NUMBERS:
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} is a number of at least 0, not {value}")
        if self.on_obstacle not in ON_OBSTACLE:
            raise ValueError(f"on_obstacle is 'wait' or 'around', not '{self.on_obstacle}'")
        if len(self.map.split()) > 1:
            raise ValueError(f"a map's name has no spaces: '{self.map}'")

    def to_text(self) -> str:
        """The constraints as text; empty if there are none."""
        values = {name: value for name, value in vars(self).items() if value != getattr(_NOTHING, name)}
        said = [f"{name}={str(value).lower() if isinstance(value, bool) else value}" for name, value in values.items()]
        return " ".join((PREFIX, *said)) if said else ""

    @classmethod
    def from_text(cls, text: str) -> Constraints:
        """What a goal's text says, nothing where it is not ours; raises `ValueError` if something of ours cannot be."""
        if not text.startswith(PREFIX):
            return cls()
        given: dict[str, Any] = {}
        for part in text[len(PREFIX) :].split():
            name, _, word = part.partition("=")
            if name not in _NAMES:
                raise ValueError(f"'{name}' is no constraint; there are {', '.join(_NAMES)}")
            given[name] = _value(name, word)
        return cls(**given)


def _value(name: str, word: str) -> Any:
    if name in ("on_obstacle", "map"):
        return word
    if name not in _NUMBERS:
        if word not in _WORDS:
            raise ValueError(f"{name} is true or false, not '{word}'")
        return _WORDS[word]
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"{name} is a number, not '{word}'") from None


_NAMES = tuple(one.name for one in fields(Constraints))
_NUMBERS = _NAMES[:8]
_NOTHING = Constraints()
