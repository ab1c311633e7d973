"""The large messages lent to one reader of a lane."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from bridge.hub.lane.blocks import Block, Blocks

MAX_LENT = 64 << 20
"""Maximum number of bytes lent to one reader, except for a single message; further ones are sent in parts."""

MAX_LOANS = 4
"""Maximum number of messages of a key that are lent to one reader; further ones wait until it has returned one."""


class Borrower(Protocol):
    """The lane of one key to the reader."""

    loans: int


class _Loan(NamedTuple):
    borrower: Borrower
    block: Block
    size: int


class Loans:
    """The loans of one reader. Not thread-safe: the lock of the reader's link guards it.

    Attributes:
        next: number of the next loan.
    """

    def __init__(self, blocks: Blocks) -> None:
        self._blocks = blocks
        self._loans: dict[int, _Loan] = {}
        self._bytes = 0
        self.next = 1

    def has_room(self, size: int) -> bool:
        """Return whether a message of ``size`` bytes may be lent."""
        return not self._loans or self._bytes + size <= MAX_LENT

    def begin(self, borrower: Borrower, block: Block, size: int) -> None:
        """Note that the next loan was sent."""
        self._blocks.share(block)
        self._loans[self.next] = _Loan(borrower, block, size)
        self.next = self.next % 0xFFFF_FFFF + 1
        self._bytes += size
        borrower.loans += 1

    def end(self, number: int) -> None:
        """End a loan that the reader has returned."""
        loan = self._loans.pop(number, None)
        if loan is not None:
            self._bytes -= loan.size
            loan.borrower.loans -= 1
            self._blocks.release(loan.block)

    def lose(self) -> None:
        """End all loans, because the connection has ended; the reader may still read the blocks."""
        for loan in self._loans.values():
            self._blocks.release(loan.block, lost=True)
        self._loans.clear()
