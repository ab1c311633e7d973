from collections import deque
from collections.abc import Callable
from typing import Any

from bridge.hub.lane.links import Sender

class Deadline:
    until: float

class Doorway:
    open: bool
    releasing: bool
    @property
    def messages(self) -> int: ...
    @property
    def bytes(self) -> int: ...
    @property
    def last(self) -> float: ...
    @property
    def carrying(self) -> float: ...
    @property
    def carried(self) -> list[int]: ...
    def __init__(
        self,
        deliver: Callable[[Any, str, int | None], None],
        lease: Deadline,
        hold: object,
        held: deque[Any],
        program: tuple[object, int, int, Any, Any] | None,
        limit: int,
        bounds: tuple[float, ...],
        /,
    ) -> None: ...
    def __call__(self, payload: Any, source: str, time_ns: int | None, /) -> None: ...
    def admit(self, source: str, sender: Sender, /) -> None: ...
    def dismiss(self, source: str, /) -> None: ...
