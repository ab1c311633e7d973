"""The messages of a piece of a file as stored: a table of their positions instead of an object for each."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ROW_BYTES = 40
"""Bytes of a row; the rows of small messages need more memory than the messages themselves."""

_BLOCK = 1 << 20
"""Bytes of messages, with their rows, that are turned into objects at a time."""

Lists = tuple[list[int], list[int], list[int], list[bytes]]
"""Channels, times, publish times and data of messages."""


class Rows(NamedTuple):
    """The messages of a piece. `bridge.bags.split` fills the ``table``."""

    data: bytes
    table: NDArray[np.uint64]

    @property
    def numbers(self) -> NDArray[np.uint64]:
        """The numbers of the channels or connections."""
        return self.table[:, 0]

    @property
    def times(self) -> NDArray[np.uint64]:
        """The times by which messages are ordered."""
        return self.table[:, 1]

    def select(self, selection: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Rows:
        """Return some of the messages, by index or by mask."""
        return Rows(self.data, self.table[selection])

    def ordered(self) -> Rows:
        """Return the messages in order of time; messages of the same time keep their order."""
        times = self.times
        return self if (times[1:] >= times[:-1]).all() else self.select(np.argsort(times, kind="stable"))

    def of_channels(self, numbers: Collection[int]) -> Rows:
        """Return the messages of some channels."""
        present = set(np.unique(self.numbers).tolist())
        return (
            self if present <= set(numbers) else self.select(np.isin(self.numbers, np.array(list(numbers), np.uint64)))
        )

    def within(self, start_ns: int | None, end_ns: int | None) -> Rows:
        """Return the messages with ``start_ns <= time < end_ns``."""
        mask = np.ones(len(self.table), np.bool_)
        if start_ns is not None:
            mask &= self.times >= start_ns
        if end_ns is not None:
            mask &= self.times < end_ns
        return self if mask.all() else self.select(mask)

    def compact(self) -> Rows:
        """Return the same messages without the data of others."""
        table, data = self.table.copy(), bytearray()
        sizes = table[:, 4]
        table[:, 3] = np.cumsum(sizes) - sizes
        for block in self.blocks():
            data += b"".join(block.messages())
        return Rows(bytes(data), table)

    def behind(self, earlier: Rows) -> Rows:
        """Return ``earlier``, followed by these messages."""
        table = np.concatenate((earlier.table, self.table))
        table[len(earlier.table) :, 3] += len(earlier.data)
        return Rows(earlier.data + self.data, table)

    def weights(self) -> NDArray[np.uint64]:
        """Return the bytes of memory of all messages up to and including each."""
        return np.cumsum(self.table[:, 4] + ROW_BYTES)

    def blocks(self) -> Iterator[Rows]:
        """Yield consecutive parts that are small enough to become objects."""
        weights = self.weights()
        start, before = 0, 0
        while start < len(weights):
            end = max(start + 1, int(np.searchsorted(weights, np.uint64(before + _BLOCK), "right")))
            yield self.select(slice(start, end))
            start, before = end, int(weights[end - 1])

    def messages(self) -> list[bytes]:
        """Return the data of each message."""
        data = self.data
        return [data[begin : begin + size] for begin, size in self.table[:, 3:].tolist()]

    def that_start_with(self, start: bytes) -> list[int]:
        """Return the indexes of the messages whose data start with these bytes."""
        data, sizes = np.frombuffer(self.data, np.uint8), self.table[:, 4]
        indexes = np.flatnonzero(sizes >= len(start))
        indexes = indexes[data[self.table[indexes, 3].astype(np.intp)] == start[0]]
        return [index for index in indexes.tolist() if self.data.startswith(start, int(self.table[index, 3]))]

    def lists(self) -> Lists:
        """Return channels, times, publish times and data."""
        numbers, times, publish_times = self.table[:, :3].T.tolist()
        return numbers, times, publish_times, self.messages()
