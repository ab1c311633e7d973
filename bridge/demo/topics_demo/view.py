"""The output of the demo: every route, in a live table on a terminal or else in periodic lines, and the checks."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from bridge.client.errors import ClientError
from bridge.client.graph import ask_decisions
from bridge.client.session import Client, connect
from bridge.client.status import ask_status
from bridge.demo.sandbox import Sandbox
from bridge.demo.topics_demo.checks import CrossingCheck
from bridge.display.documents import routes_table
from bridge.status import StatusDocument
from bridge.text import clean, make_console

_LIVE_EVERY, _PLAIN_EVERY = 0.5, 2.0
"""Seconds between two queries of the workers."""


class TopicsView:
    """The demo's output, and its session on the hub while the daemon runs."""

    def __init__(self, sandbox: Sandbox) -> None:
        self._sandbox = sandbox
        self._console = make_console()
        self._live: Live | None = None
        self._stack = contextlib.ExitStack()
        self._client: Client | None = None
        self._documents: Sequence[StatusDocument] = ()
        self._refreshed = self._began = time.monotonic()
        self._doing = ""
        self._reasons: dict[str, list[str]] = {}

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live = self._stack.enter_context(
                Live(console=self._console, auto_refresh=False, transient=True, vertical_overflow="crop")
            )
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self._stack.close()
        self._live = self._client = None

    def tick(self, doing: str) -> None:
        """Show the current activity, and periodically the routes."""
        if doing != self._doing:
            self.print_line(doing)
        if time.monotonic() - self._refreshed < (_LIVE_EVERY if self._live else _PLAIN_EVERY):
            return
        self.refresh()
        self._doing = doing
        if self._live:
            self._live.update(self._picture(), refresh=True)
        elif self._documents:
            self._console.print(f"{self._time()} {_one_line(self._documents)}")

    def print_line(self, doing: str) -> None:
        """Show one line."""
        self._doing = doing
        if self._live:
            self._live.update(self._picture(), refresh=True)
        else:
            self._console.print(f"{self._time()} {doing}")

    def refresh(self) -> None:
        """Query the workers' routes; keep the last answer if they do not respond."""
        self._refreshed = time.monotonic()
        try:
            if self._client is None:
                self._client = self._stack.enter_context(connect(self._sandbox.config, 0.2))
            self._documents = ask_status(self._client)
        except ClientError:
            return  # still starting, or just ended: the demo itself watches its processes

    def explain_failures(self, checks: Sequence[CrossingCheck]) -> None:
        """Query the decisions on the topics of failed checks, while the workers run."""
        topics = dict.fromkeys(check.topic for check in checks if not check.ok)
        self._reasons = {topic: _reasons(self._client, topic) for topic in topics} if self._client else {}

    def show(self, checks: Sequence[CrossingCheck]) -> None:
        """Print the routes and the checks."""
        console = self._live.console if self._live else self._console
        if self._documents:
            console.print(routes_table(self._documents))
        table = Table(title="Bridged topics, as reported by the programs", title_justify="left")
        for column in ("", "check", "from", "to", "topic", "expected", "seen"):
            table.add_column(column, overflow="fold")
        for check in checks:
            mark = Text("ok", style="green") if check.ok else Text("NO", style="bold red")
            texts = (check.name, check.source, check.target, check.topic, check.expected, check.seen)
            table.add_row(mark, *map(Text, texts))
        console.print(table)
        for topic, reasons in self._reasons.items():
            for reason in reasons:
                console.print(Text(f"{topic}: {reason}", style="yellow"))
        failed = sum(1 for check in checks if not check.ok)
        verdict = f"{failed} of {len(checks)} checks failed" if failed else f"all {len(checks)} checks passed"
        console.print(Text(verdict, style="bold red" if failed else "bold green"))

    def routes(self) -> list[dict[str, Any]]:
        """Return every route as its worker last reported it."""
        return [
            {"worker": document.worker, **route.document()} for document in self._documents for route in document.routes
        ]

    def _picture(self) -> RenderableType:
        return Group(Text(f"{self._time()} {self._doing}"), routes_table(self._documents))

    def _time(self) -> str:
        return f"{time.monotonic() - self._began:5.1f} s"


def _reasons(client: Client, topic: str) -> list[str]:
    """Return each worker's reason for not bridging a topic as expected."""
    lines = []
    for decision in ask_decisions(client, topic, kind=None):
        if decision.decision not in ("bridged", "own"):
            parts = (decision.direction, decision.decision, decision.why, decision.cure)
            lines.append(f"{decision.worker}: " + ", ".join(clean(part) for part in parts if part))
    return lines


def _one_line(documents: Sequence[StatusDocument]) -> str:
    parts = []
    for document in documents:
        if routes := document.routes:
            rate = sum(route.rate or 0.0 for route in routes)
            drops = sum(sum(route.drops.values()) for route in routes)
            parts.append(f"{document.worker}: {len(routes)} routes, {rate:.0f} msg/s, {drops} dropped")
        else:
            parts.append(f"{document.worker}: {document.state}")
    return " | ".join(parts)
