"""The daemon: lines between it and its workers, locks in the state folder, priorities of log lines."""

from __future__ import annotations

import json

from bridge.daemon.protocol import ProtocolError
from tests.fuzz.target import JSON_WORDS, Subject, Target, scratch, texts

_WORDS = [*JSON_WORDS, *texts('"config":', '"stop":', '"beat":', '"state":', '"log":', "[3,")]


def _command() -> Subject:
    """Commands to a worker."""
    from bridge.config.model import Config
    from bridge.daemon.protocol import NewConfig, Stop, decode_command, encode_command

    def parse(data: bytes) -> None:
        decode_command(data)

    seeds = [encode_command(Stop()), encode_command(NewConfig(Config(name="a")))]
    return Subject(parse, seeds, (ProtocolError,), _WORDS)


def _report() -> Subject:
    """Reports of a worker."""
    from bridge.daemon.protocol import (
        Beat,
        Failed,
        Hello,
        LogLine,
        Reloaded,
        Restart,
        Unknown,
        decode_report,
        encode_report,
    )
    from bridge.progress import Busy
    from bridge.worker import Health

    def parse(data: bytes) -> None:
        report = decode_report(data)
        if not isinstance(report, Unknown):
            again = decode_report(encode_report(report))
            assert not isinstance(again, Unknown)
            assert encode_report(again) == encode_report(report)

    reports = (
        Busy("a", 0.5, 2),
        Beat(3, Health("running", "x")),
        Hello(1, "daemon"),
        Reloaded(),
        Restart("x"),
        Failed("y"),
        LogLine(20, "z"),
    )
    return Subject(parse, [encode_report(report) for report in reports], (ProtocolError,), _WORDS)


def _lines() -> Subject:
    """A stream is split into the same lines however it is fragmented; the first byte sets the size of the fragments."""
    from bridge.daemon.protocol import Lines

    def parse(data: bytes) -> None:
        step, stream = data[0] + 1 if data else 1, data[1:]
        pieces, whole = Lines(64), Lines(64)
        some = [
            line for at in range(0, len(stream), step) for line in pieces.feed(stream[at : at + step])
        ] + pieces.end()
        assert all(len(line) <= 64 for line in some)
        assert some == whole.feed(stream) + whole.end(), some

    return Subject(
        parse,
        [b"\5abc\ndef\n", b"\1" + b"x" * 200 + b"\nshort\n", b"\0\n\n\n"],
        (),
        texts("\n", "x" * 64, "x" * 65),
        600,
    )


def _lock() -> Subject:
    """The text in a lock's file."""
    from bridge.daemon.lock import Lock

    path = scratch() / "lock"
    lock = Lock(path)

    def parse(data: bytes) -> None:
        path.write_bytes(data)
        holder = lock.holder()
        assert holder is None or isinstance(holder.pid, int)

    seeds = [json.dumps({"pid": 7, "machine": "robot", "owner": "daemon"}).encode(), b""]
    return Subject(parse, seeds, (), [*JSON_WORDS, *texts('"pid":', '"owner":')])


def _log() -> Subject:
    """Log lines of a worker, with systemd's priority prefixes."""
    from bridge.daemon.log import split_priority

    def parse(data: bytes) -> None:
        level, text = split_priority(data.decode(errors="replace"))
        assert isinstance(level, int)
        assert isinstance(text, str)

    return Subject(parse, texts("<3>bad", "<6>fine", "plain"), (), texts("<", ">", "<7>", "<9>"))


def _record() -> Subject:
    """Election records of workers on one network; parsed ones are written as the same record again."""
    from bridge.routing.election import Claim, Record

    def parse(data: bytes) -> None:
        record = Record.decode(data)
        assert record is None or Record.decode(record.encode()) == record

    claim = Claim(1_700_000_000_000_000_000, True, 3)
    record = Record("a", "robot", 7, {"b": 6}, frozenset("ab"), "m 1 2", claim, {frozenset("cd"): claim})
    return Subject(
        parse, [record.encode()], (), [*JSON_WORDS, *texts('"acks":', '"carries":', "[[], []]", "[1,true,3]")]
    )


TARGETS = (
    Target("record", 10_000, _record),
    Target("command", 5_000, _command),
    Target("report", 20_000, _report),
    Target("lines", 15_000, _lines),
    Target("lock", 6_000, _lock),
    Target("log_line", 10_000, _log),
)
