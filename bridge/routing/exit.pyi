from collections import deque
from collections.abc import Callable, Collection
from typing import Any

from bridge.routing.doorway import Deadline

class Exit:
    open: bool
    since: float
    @property
    def messages(self) -> int: ...
    @property
    def bytes(self) -> int: ...
    @property
    def waited(self) -> int: ...
    @property
    def last(self) -> float: ...
    @property
    def buckets(self) -> list[int]: ...
    @property
    def latencies(self) -> list[int]: ...
    @property
    def acceptor(self) -> object: ...
    def __init__(
        self,
        lease: Deadline,
        hold: object,
        waiting: tuple[deque[Any], ...],
        locked: tuple[Callable[[], bool], ...],
        program: tuple[object, int, int, Any, Any] | None,
        limit: int,
        bounds: tuple[int, ...],
        /,
    ) -> None: ...
    def add_latency(self, nanoseconds: int, /) -> None: ...
    def send_by(self, owner: object, /) -> None: ...
    def allow(self, gids: Collection[Any], /) -> None: ...
