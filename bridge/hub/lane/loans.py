"""The large messages lent to one reader of a lane."""

from __future__ import annotations

from typing import Generic, NamedTuple

from bridge.hub.lane.blocks import Block, Blocks
from bridge.hub.lane.queues import Queue

MAX_LENT = 64 << 20
"""Maximum number of bytes lent to one reader, except for a single message; further ones are sent in parts."""


class Loan(NamedTuple, Generic[Queue]):
    """A message of a key that is lent, in a block."""

    queue: Queue
    block: Block
    size: int


class Loans(Generic[Queue]):
    """The loans of one reader. Not thread-safe: the lock of the reader's link guards it.

    Attributes:
        next: number of the next loan.
    """

    def __init__(self, blocks: Blocks) -> None:
        self._blocks = blocks
        self._loans: dict[int, Loan[Queue]] = {}
        self._bytes = 0
        self.next = 1

    def has_room(self, size: int) -> bool:
        """Return whether a message of ``size`` bytes may be lent."""
        return not self._loans or self._bytes + size <= MAX_LENT

    def begin(self, queue: Queue, block: Block, size: int) -> None:
        """Note that the next loan, a message of the given queue, was sent."""
        self._blocks.share(block)
        self._loans[self.next] = Loan(queue, block, size)
        self.next = self.next % 0xFFFF_FFFF + 1
        self._bytes += size
        queue.loans += 1

    def end(self, number: int) -> Loan[Queue] | None:
        """End a loan that the reader has returned, whose block the caller releases; None if the loan is unknown."""
        loan = self._loans.pop(number, None)
        if loan is not None:
            self._bytes -= loan.size
            loan.queue.loans -= 1
        return loan

    def lose(self) -> None:
        """End all loans, because the connection has ended; the reader may still read the blocks."""
        for loan in self._loans.values():
            self._blocks.release(loan.block, lost=True)
        self._loans.clear()
