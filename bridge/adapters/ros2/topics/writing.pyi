from collections.abc import Callable

class Writer:
    open: bool
    @property
    def written(self) -> int: ...
    @property
    def output(self) -> object: ...
    def __init__(
        self, publish: int, reset_error: int, publisher: int, large: int, locked: tuple[Callable[[], bool], ...], /
    ) -> None: ...
