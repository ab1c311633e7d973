"""Derives new inputs from valid ones: flips, cuts, splices, wrong lengths, deep nesting."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence

_NUMBER = re.compile(rb"\d+")
_EDGES = (0, 1, 2, 3, 4, 7, 8, 16, 0x7F, 0x80, 0xFF, 0x100, 0x7FFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_TEXT_NUMBERS = (
    b"-1",
    b"0",
    b"4294967296",
    b"18446744073709551616",
    b"1e999",
    b"nan",
    b"9" * 400,
    b"0x10",
    b"1_0",
    b"\xd9\xa3",
)
_OPENERS = (
    b"[",
    b"{",
    b'{"a":',
    b"[[",
    b"(",
    b"<a>",
    b"- ",
    b"<value><array><data>",
    b"a/",
    b"/",
    b"%",
    b",",
    b":",
    b"\n",
    b"&a [*a,",
    b"'",
)
_KEPT = 2000


class Mutator:
    """An endless sequence of inputs, reproducible for the same seed and the same calls of `keep`.

    Args:
        seeds: valid inputs.
        tokens: tokens of the format.
        largest: maximum input size in bytes.
        seed: of the random generator.
    """

    def __init__(self, seeds: Sequence[bytes], tokens: Sequence[bytes], largest: int, seed: int | str) -> None:
        self._corpus = list(seeds) or [b""]
        self._seeds = len(self._corpus)
        self._tokens = list(tokens)
        self._largest = largest
        self._dice = random.Random(seed)
        self._steps: list[Callable[[bytearray], bytearray | None]] = [
            self._flip, self._flip, self._set, self._set, self._edge, self._edge, self._edge,
            self._cut_end, self._cut_out,
            self._double, self._splice, self._insert_noise, self._nest,
            *((self._insert_token, self._replace_by_token) if self._tokens else ()),
            *((self._number,) if any(_NUMBER.search(s) for s in self._corpus) else ()),
        ]  # fmt: skip

    def keep(self, content: bytes) -> None:
        """Add an input with new coverage, from which others are derived."""
        if len(self._corpus) < self._seeds + _KEPT:
            self._corpus.append(content)
        else:
            self._corpus[self._dice.randrange(self._seeds, len(self._corpus))] = content

    def next(self) -> bytes:
        """Return the next input."""
        dice = self._dice
        content = bytearray(self._corpus[int(dice.random() * len(self._corpus))])
        for _ in range(1 + int(dice.random() * dice.random() * 5)):
            step = self._steps[int(dice.random() * len(self._steps))]
            content = step(content) or content
        return bytes(content[: self._largest])

    def _position(self, content: bytearray, room: int = 1) -> int:
        return int(self._dice.random() * max(len(content) - room + 1, 0))

    def _flip(self, content: bytearray) -> None:
        if content:
            content[self._position(content)] ^= 1 << int(self._dice.random() * 8)

    def _set(self, content: bytearray) -> None:
        if content:
            content[self._position(content)] = int(self._dice.random() * 256)

    def _edge(self, content: bytearray) -> None:
        """Replace one, two, four or eight bytes, most often four aligned ones, with a number at or near a limit.

        The number is an edge case, the size of the rest of the input, or the previous one; the latter two are changed
        by a few units.
        """
        dice = self._dice
        width = 4 if dice.random() < 0.7 else (1, 2, 8)[int(dice.random() * 3)]
        if len(content) < width:
            return
        at = self._position(content, width)
        if dice.random() < 0.7:
            at -= at % width
        kind = dice.random()
        if kind < 0.5:
            value = _EDGES[int(dice.random() * len(_EDGES))]
        elif kind < 0.8:
            value = len(content) - at + int(dice.random() * 17) - 8
        else:
            value = int.from_bytes(content[at : at + width], "little") + int(dice.random() * 9) - 4
        order = "big" if dice.random() < 0.1 else "little"
        content[at : at + width] = (value & ((1 << 8 * width) - 1)).to_bytes(width, order)  # type: ignore[arg-type]

    def _cut_end(self, content: bytearray) -> None:
        del content[self._position(content) :]

    def _cut_out(self, content: bytearray) -> None:
        at = self._position(content)
        del content[at : at + 1 + int(self._dice.random() * self._dice.random() * len(content))]

    def _double(self, content: bytearray) -> None:
        at, size = self._position(content), 1 + int(self._dice.random() * 32)
        content[at:at] = content[at : at + size]

    def _splice(self, content: bytearray) -> bytearray:
        other = self._corpus[int(self._dice.random() * len(self._corpus))]
        return content[: self._position(content)] + other[int(self._dice.random() * (len(other) + 1)) :]

    def _insert_noise(self, content: bytearray) -> None:
        at = self._position(content, 0)
        content[at:at] = self._dice.randbytes(1 + int(self._dice.random() * 16))

    def _insert_token(self, content: bytearray) -> None:
        at = self._position(content, 0)
        content[at:at] = self._tokens[int(self._dice.random() * len(self._tokens))]

    def _replace_by_token(self, content: bytearray) -> None:
        at, token = self._position(content, 0), self._tokens[int(self._dice.random() * len(self._tokens))]
        content[at : at + len(token)] = token

    def _number(self, content: bytearray) -> None:
        numbers = list(_NUMBER.finditer(content[:4096]))
        if numbers:
            place = numbers[int(self._dice.random() * len(numbers))]
            content[place.start() : place.end()] = _TEXT_NUMBERS[int(self._dice.random() * len(_TEXT_NUMBERS))]

    def _nest(self, content: bytearray) -> None:
        """Repeat a short piece many times (deep nesting, long names, many fields); rarely, because this is slow."""
        dice = self._dice
        if dice.random() > 0.1:
            return
        at, size = self._position(content, 0), 1 + int(dice.random() * 24)
        piece = bytes(content[at : at + size]) if dice.random() < 0.5 else _OPENERS[int(dice.random() * len(_OPENERS))]
        if piece:
            content[at:at] = piece * min(1 << int(dice.random() * 14), self._largest // len(piece))
