"""The terminal during playback: keys, and a progress line."""

from __future__ import annotations

import sys
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING, Self

from bridge.cli.keyboard import GONE, pressed, raw

if TYPE_CHECKING:
    from bridge.bags.play.player import Player
    from bridge.bags.play.source import PlaySource

_CLEAR = "\r\x1b[K"


class Screen:
    """Reads keys and shows the progress, if there is a terminal; a context manager."""

    def __init__(self, player: Player, source: PlaySource, *, keys: bool, progress: bool) -> None:
        self._player, self._source = player, source
        self._keys, self._progress = keys, progress
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        if self._keys:
            self._stack.enter_context(raw(sys.stdin.fileno()))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
        if self._progress:
            print(_CLEAR, end="", file=sys.stderr, flush=True)

    def poll(self, seconds: float, ended: threading.Event) -> bool:
        """Wait up to ``seconds`` for keys, and show the progress; return whether to quit."""
        if self._progress:
            print(f"{_CLEAR}{self.line()}", end="", file=sys.stderr, flush=True)
        if not self._keys:
            ended.wait(seconds)
            return False
        return any(map(self.press, pressed(sys.stdin.fileno(), seconds)))

    def press(self, key: str) -> bool:
        """Handle a key; return whether it means quit."""
        timeline = self._player.timeline
        if key == " ":
            timeline.pause(not timeline.paused)
        elif key in ".s":
            timeline.step()
        return key in ("q", GONE)

    def line(self) -> str:
        """Return the progress: ``12.3 of 60.0 s, rate 1, 456 messages, paused``."""
        source, timeline = self._source, self._player.timeline
        at = max(0.0, (timeline.now_ns() - source.begin_ns) / 1e9)
        total = (source.end_ns - source.begin_ns) / 1e9
        parts = [f"{at:.1f} of {total:.1f} s", f"rate {timeline.rate:g}", f"{self._player.played.total()} messages"]
        if dropped := self._player.dropped.total():
            parts.append(f"{dropped} dropped")
        if timeline.paused:
            parts.append("paused")
        return ", ".join(parts)
