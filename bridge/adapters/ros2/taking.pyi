from collections.abc import Callable, Sequence

from bridge.adapters.ros2.loop import EndpointReader

ON_NEW_MESSAGES: int

def publish(function: int, publisher: int, payload: bytes | memoryview, large: int, /) -> int: ...

class Queue:
    def __init__(
        self,
        take_serialized: int,
        take: int,
        reset_error: int,
        default_allocator: int,
        large: int,
        flush: Callable[[], None] = ...,
        /,
    ) -> None: ...
    def add(self, reader: EndpointReader, subscription: int, /) -> int: ...
    def deliver(
        self,
        data: int,
        call: Callable[[bytes, str, int | None], None],
        sources: dict[bytes, str],
        sequences: dict[str, int],
        /,
    ) -> None: ...
    def remove(self, data: int, /) -> None: ...
    def wait(self) -> Sequence[tuple[EndpointReader, bytes | None, bytes, int, int]]: ...
    def wake(self) -> None: ...
