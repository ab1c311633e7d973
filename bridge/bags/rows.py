"""Messages as they stand in a piece of a file: a table of where each is, and few objects at a time."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.bags.bag import BagTopic, Columns

ROW_BYTES = 40
"""Bytes of a row; those of small messages take more room than the messages themselves."""

_BLOCK = 1 << 20
"""Bytes of messages, and their rows, of which objects are made at once."""


class Rows(NamedTuple):
    """Messages of a piece. ``table`` is as `bridge.bags.split` fills it."""

    data: bytes
    table: NDArray[np.uint64]

    @property
    def numbers(self) -> NDArray[np.uint64]:
        """Channels, or connections."""
        return self.table[:, 0]

    @property
    def times(self) -> NDArray[np.uint64]:
        """Times by which they are ordered."""
        return self.table[:, 1]

    def take(self, which: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Rows:
        """Some of them, by place or by mask."""
        return Rows(self.data, self.table[which])

    def ordered(self) -> Rows:
        """In order of time; those of the same time stay as they are."""
        times = self.times
        return self if (times[1:] >= times[:-1]).all() else self.take(np.argsort(times, kind="stable"))

    def of(self, numbers: Collection[int]) -> Rows:
        """Those of some channels."""
        found = set(np.unique(self.numbers).tolist())
        return self if found <= set(numbers) else self.take(np.isin(self.numbers, np.array(list(numbers), np.uint64)))

    def within(self, start_ns: int | None, end_ns: int | None) -> Rows:
        """Those with ``start_ns <= time < end_ns``."""
        mask = np.ones(len(self.table), np.bool_)
        if start_ns is not None:
            mask &= self.times >= start_ns
        if end_ns is not None:
            mask &= self.times < end_ns
        return self if mask.all() else self.take(mask)

    def compact(self) -> Rows:
        """The same, with their own data alone."""
        table, data = self.table.copy(), bytearray()
        sizes = table[:, 4]
        table[:, 3] = np.cumsum(sizes) - sizes
        for block in self.blocks():
            data += b"".join(block.messages())
        return Rows(bytes(data), table)

    def behind(self, earlier: Rows) -> Rows:
        """Both, in one."""
        table = np.concatenate((earlier.table, self.table))
        table[len(earlier.table) :, 3] += len(earlier.data)
        return Rows(earlier.data + self.data, table)

    def weights(self) -> NDArray[np.uint64]:
        """Bytes of memory of all messages up to each, with it."""
        return np.cumsum(self.table[:, 4] + ROW_BYTES)

    def blocks(self) -> Iterator[Rows]:
        """Parts of them, one after the other, that are small enough to make objects of."""
        weights = self.weights()
        start, before = 0, 0
        while start < len(weights):
            end = max(start + 1, int(np.searchsorted(weights, np.uint64(before + _BLOCK), "right")))
            yield self.take(slice(start, end))
            start, before = end, int(weights[end - 1])

    def messages(self) -> list[bytes]:
        """The data of each."""
        data = self.data
        return [data[begin : begin + size] for begin, size in self.table[:, 3:].tolist()]

    def that_start_with(self, start: bytes) -> list[int]:
        """Places of the messages whose data start with these bytes."""
        data, sizes = np.frombuffer(self.data, np.uint8), self.table[:, 4]
        places = np.flatnonzero(sizes >= len(start))
        places = places[data[self.table[places, 3].astype(np.intp)] == start[0]]
        return [place for place in places.tolist() if self.data.startswith(start, int(self.table[place, 3]))]

    def lists(self) -> tuple[list[int], list[int], list[int], list[bytes]]:
        """Channels, times, publish times and data."""
        numbers, times, publish_times = self.table[:, :3].T.tolist()
        return numbers, times, publish_times, self.messages()

    def columns(self, topic_of: Mapping[int, BagTopic]) -> Columns:
        """The same with topics."""
        numbers, times, publish_times, data = self.lists()
        return Columns(list(map(topic_of.__getitem__, numbers)), times, publish_times, data)
