"""How robots are to behave in an area, which YARP's own type cannot say.

People who have YARP's tools only write it into the area's description: ``loading zone, max_speed=0.2
on_obstacle=wait``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

_SETTING = re.compile(r"\b(max_speed|on_obstacle|keep_out)\b(?:[ \t]*=[ \t]*([^\s,;]*))?")
_OBSTACLE = ("", "wait", "around")
_TRUTH = {None: True, "1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}


@dataclass(frozen=True)
class AreaBehaviour:
    """What holds in an area.

    Attributes:
        max_speed: metres per second, above 0; None where the area sets no limit. Who may not drive there at all is told
            by `keep_out`: a limit of 0 means none to others.
        on_obstacle: ``wait`` until it is gone or go ``around`` it; empty where the area does not say.
        keep_out: nobody plans a way through.
    """

    max_speed: float | None = None
    on_obstacle: str = ""
    keep_out: bool = False

    def __post_init__(self) -> None:
        speed = self.max_speed
        if speed is not None and not (math.isfinite(speed) and speed > 0):
            raise ValueError(f"max_speed is metres per second above 0, not {speed}: say keep_out to keep robots away")
        if self.on_obstacle not in _OBSTACLE:
            raise ValueError(f"on_obstacle is wait or around, not {self.on_obstacle!r}")

    @classmethod
    def from_text(cls, text: str) -> AreaBehaviour | None:
        """What a description says; None where it says nothing of this.

        Raises:
            ValueError: it says something that cannot be meant.
        """
        said: dict[str, str | None] = {}
        for found in _SETTING.finditer(text):
            name, value = found.groups()
            if name in said:
                raise ValueError(f"{name} stands twice in {text!r:.100}")
            if value is None and name != "keep_out":
                continue  # the word in a sentence
            said[name] = value
        if not said:
            return None
        return cls(
            _speed(said["max_speed"]) if "max_speed" in said else None,
            said.get("on_obstacle") or "",
            "keep_out" in said and _truth(said["keep_out"]),
        )

    def to_text(self) -> str:
        """The same as it stands in a description."""
        words = [] if self.max_speed is None else [f"max_speed={self.max_speed!r}"]
        if self.on_obstacle:
            words.append(f"on_obstacle={self.on_obstacle}")
        if self.keep_out:
            words.append("keep_out")
        return " ".join(words)


def _speed(text: str | None) -> float:
    try:
        return float(text or "")
    except ValueError:
        raise ValueError(f"max_speed is metres per second, not {text!r}") from None


def _truth(text: str | None) -> bool:
    try:
        return _TRUTH[text and text.lower()]
    except KeyError:
        raise ValueError(f"keep_out is true or false, not {text!r}") from None
