from collections.abc import Callable
from typing import Any

class Track:
    sequence: int | None
    time_ns: int
    @property
    def held(self) -> dict[int, Any]: ...

class Receiver:
    open: bool
    @property
    def by_lane(self) -> int: ...
    def __init__(self, tracks: dict[bytes, Any], locked: tuple[Callable[[], bool], ...], limit: int, /) -> None: ...
    def hand_to(self, owner: object, /) -> None: ...

def read_lane(
    socket: int,
    room: int,
    receivers: dict[int, Receiver],
    message: Callable[[int, tuple[int, int, bytes], bytes], None],
    other: Callable[[bytes, int], None],
    /,
) -> None: ...
