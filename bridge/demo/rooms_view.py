"""The output of the driving demo: the map with the robot, live on a terminal or else as lines, and the drives."""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from bridge.demo.progress import PartState, without_numbers
from bridge.demo.rooms import RoomDrive, RoomsResult
from bridge.demo.tracking import RobotTracker
from bridge.text import make_console

_LIVE_EVERY, _PLAIN_EVERY = 0.3, 2.0
_WIDEST = 100


class RoomsView:
    """The output of one run."""

    def __init__(self) -> None:
        self._console = make_console()
        self._live: Live | None = None
        self._shown, self._began = -_PLAIN_EVERY, time.monotonic()
        self._doing, self._up = "", False
        self._printed: dict[str, str] = {}

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live = Live(console=self._console, auto_refresh=False, vertical_overflow="crop", transient=True)
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None

    def tick(self, doing: str, course: RobotTracker | None, parts: Sequence[PartState]) -> None:
        """Show the current activity: the parts while they start, then the robot."""
        now = time.monotonic()
        self._up = self._up or (course is not None and course.localized)
        if course is None or not self._up:
            self._show_start(now, doing, parts)
            return
        begins = doing.partition(":")[0] != self._doing
        if not begins and now - self._shown < (_LIVE_EVERY if self._live else _PLAIN_EVERY):
            return
        self._shown, self._doing = now, doing.partition(":")[0]
        texts = course.texts()
        line = f"{self._time(now)}  {doing}  |  {texts['where']}  {texts['left']}  {texts['state']}"
        if self._live is not None:
            self._live.update(Group(*course.picture(self._width(), colored=True), Text(line)), refresh=True)
        else:
            self._console.print(Text(line))

    def _show_start(self, now: float, doing: str, parts: Sequence[PartState]) -> None:
        """Show each part and its state; without a terminal, print a line for each change."""
        if self._live is not None:
            if now - self._shown >= _LIVE_EVERY:
                self._shown = now
                lines = [Text(f"{self._time(now)}  {doing}"), *(Text(f"         {part}") for part in parts)]
                self._live.update(Group(*lines), refresh=True)
            return
        for name, line in (("", doing), *((part.name, str(part)) for part in parts)):
            if self._printed.get(name) != without_numbers(line):
                self._printed[name] = without_numbers(line)
                self._console.print(Text(f"{self._time(now)}  {line}"))

    def show(self, result: RoomsResult, course: RobotTracker) -> None:
        """Print the map and the drives."""
        for line in course.picture(self._width(), colored=self._console.is_terminal):
            self._console.print(line)
        table = Table(title="Drives", title_justify="left")
        for column in ("", "client", "room", "seconds", "distance", "last output of the client"):
            table.add_column(column, overflow="fold")
        for drive in result.drives:
            table.add_row(*_row(drive))
        self._console.print(table)
        verdict = "every room was reached" if result.ok else "not every room was reached"
        self._console.print(Text(verdict, style="bold green" if result.ok else "bold red"))

    def print_line(self, text: str) -> None:
        """Print one line, above the live view if there is one."""
        self._console.print(Text(text))

    def _time(self, now: float) -> str:
        return f"{now - self._began:5.1f} s"

    def _width(self) -> int:
        return min(_WIDEST, self._console.width)


def _row(drive: RoomDrive) -> tuple[Text, ...]:
    mark = Text("ok", style="green") if drive.reached else Text("NO", style="bold red")
    return mark, *map(Text, (drive.client, drive.room, f"{drive.seconds:.0f}", f"{drive.off:.2f} m", drive.output))
