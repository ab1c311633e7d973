def configure(
    writer_table: int, get_filter: int, set_filter: int, find_writer: int, get_readers: int, free_infos: int,
    reset_error: int, default_allocator: int, /,
) -> None: ...  # fmt: skip

class Filter:
    def __init__(self, node: int, topic: str, hashes: bytes, hashless: bool, only: bool, /) -> None: ...
    def attach(self, gid: bytes, /) -> bool: ...
