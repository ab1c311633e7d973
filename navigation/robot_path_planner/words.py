"""The words that ``/robotPathPlanner/rpc`` understands beside INavigation2D, as robotology/navigation's does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from yarp_compat.dev.navigation2d_server import Navigation2DServer

HELP = (
    "help: these lines",
    "get_robot_radius: metres kept to walls",
    "set_robot_radius R: keep R metres to walls; the way is planned anew",
)
_MOST = 3.0


class PlannerServer(Navigation2DServer):
    """Answers INavigation2D, and these words.

    Args:
        device: what INavigation2D calls.
        get_radius: says the robot's radius, metres.
        set_radius: sets it.
    """

    def __init__(self, device: object, get_radius: Callable[[], float], set_radius: Callable[[float], Any]) -> None:
        super().__init__(device)
        self._get, self._set = get_radius, set_radius

    def command(self, words: list[Any]) -> list[Any] | None:
        """What a Bottle is answered with; None where it is no command of these.

        Raises:
            ValueError: its value cannot be; the text says why.
        """
        word, *rest = words or [""]
        if word in ("help", "[help]") and not rest:
            return ["[many]", *HELP]
        if word == "get_robot_radius":
            return [self._get()]
        if word != "set_robot_radius":
            return None
        value = rest[0] if len(rest) == 1 else None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value <= _MOST:
            told = " ".join(map(str, rest)) or "nothing"
            raise ValueError(f"a robot's radius is one number above 0 and at most {_MOST:g} m, not {told}")
        self._set(float(value))
        return ["[ok]"]
