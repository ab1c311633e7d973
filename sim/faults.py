"""What can fail on the robot at a client's wish, so that those who drive it can be seen to notice."""

from __future__ import annotations

from collections.abc import Iterator

from sim.errors import SimError

KINDS = {
    "laser_silent": "no scans come",
    "laser_blind": "each beam of a scan is NaN",
    "encoders_silent": "no joint states come, and no odometry",
    "encoders_frozen": "the encoders say that the wheels stand still, whatever they do",
}


class Faults:
    """The faults that there are now."""

    def __init__(self) -> None:
        self._now: set[str] = set()

    def __contains__(self, name: str) -> bool:
        return name in self._now

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._now))

    def set(self, name: str, *, on: bool) -> str:
        """Have something fail, or work again; what it means, in words.

        Raises:
            SimError: there is no fault of the name.
        """
        if name not in KINDS:
            msg = f"there is no fault {name!r}; there are {', '.join(KINDS)}"
            raise SimError(msg)
        (self._now.add if on else self._now.discard)(name)
        return f"{name}: {KINDS[name]}" if on else f"{name} is mended"
