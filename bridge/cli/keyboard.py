"""Single key presses in a terminal, for commands that are controlled while they run."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Iterator

try:
    import termios
    import tty
except ImportError:  # Windows has no such terminals
    AVAILABLE = False
else:
    AVAILABLE = True

_MOST = 65536
"""Bytes of one read: all keys that wait, so that none of them seems to arrive later."""

GONE = "\x04"
"""Ctrl-D, also returned when the terminal has been closed."""


def pressed(terminal: int, seconds: float) -> Iterator[str]:
    """Yield the keys pressed within ``seconds``; an arrow is one key."""
    if not select.select([terminal], [], [], seconds)[0]:
        return
    text = os.read(terminal, _MOST).decode(errors="ignore")
    if not text:
        yield GONE
    while text:
        length = 3 if text.startswith("\x1b[") else 1
        yield text[:length]
        text = text[length:]


@contextlib.contextmanager
def raw(terminal: int) -> Iterator[int]:
    """Put a terminal into cbreak mode: each key at once, without echo; only if `AVAILABLE`.

    Ctrl-S is a key, too: it would stop the output, and so the command.
    """
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        settings = termios.tcgetattr(terminal)
        settings[0] &= ~termios.IXON
        termios.tcsetattr(terminal, termios.TCSADRAIN, settings)
        yield terminal
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
