"""The protocol between the daemon and a worker's process: JSON, one object per line.

Commands (daemon to worker)::

    {"config": {...}}                                    the whole configuration; the first one starts the worker
    {"config": {...}, "digests": {"ros2": "1f..."}, "driven": [["navigation", "/drive", "..."]]}
                                                         the same, with what a worker would need all sections for:
                                                         digests of the files that they name, topics that move the robot
    {"stop": true}

Reports (worker to daemon)::

    {"busy": "importing rclpy", "used": 1.2, "read": 8}  every half second while the main loop is busy with one step,
                                                         also during the start, from a separate thread: the step,
                                                         processor time in seconds, blocks read from disks
    {"hello": {"pid": 1, "owner": "daemon"}}             the first report on a control socket
    {"beat": 1, "state": "running", "text": "2 routes"}  every half second, from the worker's main loop; every second
                                                         while it is running and its text does not change
    {"reloaded": true}                                   the new configuration is applied
    {"restart": "why"}                                   the new configuration needs a restart of the worker
    {"failed": "why"}                                    the worker failed for this reason; its process exits
    {"log": [30, "text"]}                                a log line of a worker that has a control socket

Unknown reports are ignored, because a worker that outlives its daemon may have another version.
The end of the daemon's stream is also a stop command, except for a worker with a control socket, which outlives the
daemon.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

from bridge.config.digests import digests
from bridge.config.model import Config
from bridge.config.sections.section import DrivenTopic
from bridge.daemon.heartbeat import busy_line
from bridge.progress import Busy
from bridge.worker import Health

MAX_LINE = 4 << 20
BEAT_INTERVAL = 0.5
QUIET_INTERVAL = 1.0
"""Seconds after a heartbeat that is "running" with the same text as the previous one."""

EXIT_CANNOT_WORK = 78
"""Exit code of a worker that cannot work on this machine (EX_CONFIG of sysexits.h)."""

Owner = Literal["daemon", "service"]
"""Who started a worker that outlives the daemon, and therefore stops it."""


class ProtocolError(ValueError):
    """A line violates the protocol."""


class Unknown(NamedTuple):
    """Report of another version of the protocol."""

    keys: tuple[str, ...]


class NewConfig(NamedTuple):
    """Command: start with this configuration, or change to it."""

    config: Config


class Stop(NamedTuple):
    """Command: unregister everything and exit."""

    why: str = "requested"


class Hello(NamedTuple):
    """Report: the process and the owner of a worker with a control socket."""

    pid: int
    owner: Owner


class Beat(NamedTuple):
    """Report: a heartbeat."""

    number: int
    health: Health


@dataclass(frozen=True, slots=True)
class Reloaded:
    """Report: the new configuration is applied (or rejected, by a service with its own file)."""


class Restart(NamedTuple):
    """Report: the new configuration needs a restart of this worker; a service restarts itself."""

    why: str


class Failed(NamedTuple):
    """Report: the worker failed for a reason."""

    why: str


class LogLine(NamedTuple):
    """Report: one log line; ``level`` as in `logging`."""

    level: int
    text: str


_REPORTS = ("hello", "busy", "beat", "reloaded", "restart", "failed", "log")

Command = NewConfig | Stop
Report = Hello | Busy | Beat | Reloaded | Restart | Failed | LogLine


def config_json(config: Config) -> dict[str, Any]:
    """Return a configuration as plain data that `Config` can validate."""
    return config.model_dump(mode="json", by_alias=True)


def encode_command(command: Command) -> bytes:
    """Encode a command as one line."""
    match command:
        case NewConfig(config):
            files = dict(digests(config))
            known = {"digests": files} if files else {}
            return _line({"config": config_json(config), "driven": config.driven_topics, **known})
        case Stop():
            return _line({"stop": True})


def decode_command(line: bytes, parse: Callable[[dict[str, Any]], Config] = Config.model_validate) -> Command:
    """Decode a command from its line; ``parse`` makes a configuration from plain data. Raises `ProtocolError`."""
    data = _object(line)
    if data.get("stop") is True:
        return Stop("requested by the daemon")
    if "config" in data:
        try:
            config = parse(data["config"])
            config.set_digests({key: str(digest) for key, digest in data.get("digests", {}).items()})
            if "driven" in data:
                config.set_driven(tuple(DrivenTopic(*map(str, topic)) for topic in data["driven"]))
            return NewConfig(config)
        except Exception as err:  # also of the code of another package's section
            raise ProtocolError(f"an invalid configuration: {err}") from err
    raise ProtocolError(f"not a command: {line[:200]!r}")


def encode_report(report: Report) -> bytes:
    """Encode a report as one line."""
    match report:
        case Busy():
            return busy_line(report)
        case Hello(pid, owner):
            return _line({"hello": {"pid": pid, "owner": owner}})
        case Beat(number, health):
            return _line({"beat": number, "state": health.state, "text": health.text})
        case Reloaded():
            return _line({"reloaded": True})
        case Restart(why):
            return _line({"restart": why})
        case Failed(why):
            return _line({"failed": why})
        case LogLine(level, text):
            return _line({"log": [level, text]})


def decode_report(line: bytes) -> Report | Unknown:
    """Decode a report from its line; raises `ProtocolError`."""
    data = _object(line)
    match data:
        case {"beat": int(number), "state": ("running" | "waiting" | "standby") as state, "text": str(text)}:
            return Beat(number, Health(state, text))
        case {"hello": {"pid": int(pid), "owner": str(owner)}} if owner in get_args(Owner):
            return Hello(pid, "service" if owner == "service" else "daemon")
        case {"reloaded": True}:
            return Reloaded()
        case {"restart": str(why)}:
            return Restart(why)
        case {"failed": str(why)}:
            return Failed(why)
        case {"log": [int(level), str(text)]}:
            return LogLine(level, text)
        case {"busy": str(text), "used": (int() | float()) as used, "read": int(read)}:
            return Busy(text, used, read)
    if data and data.keys().isdisjoint(_REPORTS):
        return Unknown(tuple(data))
    raise ProtocolError(f"not a report: {line[:200]!r}")


def _line(data: dict[str, Any]) -> bytes:
    return json.dumps(data, separators=(",", ":")).encode() + b"\n"


def _object(line: bytes) -> dict[str, Any]:
    try:
        data = json.loads(line)
    except (ValueError, RecursionError) as err:
        raise ProtocolError(f"not JSON: {line[:200]!r}") from err
    if not isinstance(data, dict):
        raise ProtocolError(f"not an object: {line[:200]!r}")
    return data


class Lines:
    """Splits a stream of bytes into lines; a line longer than the limit is truncated."""

    def __init__(self, limit: int = MAX_LINE) -> None:
        self._limit = limit
        self._rest = b""
        self._skipping = False

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes; return the complete lines without their line ends."""
        *whole, partial = (self._rest + data).split(b"\n")
        lines: list[bytes] = []
        for line in whole:
            if not self._skipping:
                lines.append(line[: self._limit])
            self._skipping = False
        if len(partial) > self._limit and not self._skipping:
            lines.append(partial[: self._limit])
            self._skipping = True
        self._rest = b"" if self._skipping else partial
        return lines

    def end(self) -> list[bytes]:
        """Return the incomplete last line after the end of the stream."""
        rest, self._rest = self._rest, b""
        return [rest] if rest else []
