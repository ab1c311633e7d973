"""The sequence of a recording's files: when the next file begins, and what happens if the disk is full."""

from __future__ import annotations

import errno
import logging
import time
from pathlib import Path

from bridge.bags.mcap_writer import ChannelInfo
from bridge.client.topics import Definitions
from bridge.clock import is_jump
from bridge.hub.graph import HubGraph
from bridge.record.arrivals import RecordedMessage
from bridge.record.file import RESUME, ChannelKey, RecordFile, room
from bridge.record.latched import LatchedState
from bridge.record.places import RecordPlace
from bridge.record.ring import Ring
from bridge.record.section import RecordSection
from bridge.record.selection import side_of, tapped

_log = logging.getLogger("midspan.record")

FLUSH_SECONDS = 1.0
RETRY_SECONDS = 5.0
"""Seconds until a new file is tried after one failed."""

_DEFINITION_SECONDS = 2.5
_FULL = (errno.ENOSPC, errno.EDQUOT)


class FileSeries:
    """Writes messages into a file, and starts another file at the limit. Used only on the writer thread.

    Args:
        place: names the files.
        section: the configuration.
        about: metadata of each file.

    Attributes:
        ring: the place if it is a ring, else None.
        file: the open file, or None.
        last_path: the last file that was opened, or the folder of a saved ring.
        count: number of files so far.
        trouble: the reason why nothing is written, "" while recording works.
    """

    def __init__(
        self,
        place: RecordPlace,
        section: RecordSection,
        about: dict[str, str],
        graph: HubGraph,
        definitions: Definitions,
    ) -> None:
        self._place, self._compression, self._about = place, section.compression, about
        self._graph, self._definitions = graph, definitions
        self._latched = LatchedState(graph)
        self._flushed = self._retry = 0.0
        self._latched_bytes = 0
        self._last: RecordedMessage | None = None
        self.ring = ring = place if isinstance(place, Ring) else None
        self._most_bytes = ring.segment_bytes if ring else section.split.size << 20
        self._most_seconds = ring.segment_seconds if ring else section.split.seconds
        self.file: RecordFile | None = None
        self.last_path: Path | None = None
        self.count = 0
        self.trouble = ""

    def write(self, arrival: RecordedMessage) -> None:
        """Write a message, or count it as dropped if that is impossible."""
        try:
            was_set = self._was_clock_set(arrival)  # each file has the times of one setting of the clock
            file = None if was_set or self.file is None or self._is_over(self.file) else self.file
            file = file or self._next_file()
            if file is None:
                arrival.counts.dropped["disk"] += 1
            else:
                self._ensure_channel(file, arrival)
                file.write(arrival, arrival.log_time)
        except OSError as err:
            arrival.counts.dropped["disk"] += 1
            self._failed(err)
        self._latched.add(arrival)  # even if it was dropped, so that the next file begins with it

    def open(self) -> Path | None:
        """Open a file unless one is open, and return its path; raises `OSError` if that fails, and retries later."""
        self._retry = 0.0
        try:
            file = self.file or self._next_file()
        except OSError as err:
            self._failed(err)
            raise
        return file.path if file is not None else None

    def maintain(self, *, recording: bool) -> None:
        """Write the open chunk if it is due, delete old files of a ring, and retry to open a file if ``recording``."""
        now = time.monotonic()
        if self.file is not None and now - self._flushed >= FLUSH_SECONDS:
            self._flushed = now
            try:
                self.file.flush()
            except OSError as err:
                self._failed(err)
        if self.ring is not None:
            self.ring.prune()
        if self.file is None and recording and self.trouble and now >= self._retry:
            try:
                self._next_file()
            except OSError as err:
                self._failed(err)

    def keep(self, why: str) -> Path | None:
        """Close the file and save the ring; return its new folder, None if the ring is empty. Raises `OSError`."""
        if self.ring is None:
            raise OSError(22, "the recording has no ring (record.ring.seconds)")
        self.close({"trigger": why, "time": str(time.time_ns())})
        kept = self.ring.keep()
        if kept is not None:
            _log.info("%s: the ring was saved in %s", why, kept)
            self.last_path = kept
        return kept

    def close(self, ending: dict[str, str] | None = None) -> Path | None:
        """Close the file, with its summary if there is space, and return its path; None if no file is open."""
        file, self.file = self.file, None
        if file is None:
            return None
        try:
            try:
                written = file.close(ending)
            except OSError as err:
                _log.warning("%s ends without its summary: %s", file.path, err.strerror or err)
                written = file.abandon()
            self._place.on_closed(written)
        except OSError as err:
            _log.error("%s: %s", file.path, err.strerror or err)
        return file.path

    def _was_clock_set(self, arrival: RecordedMessage) -> bool:
        """Return whether the system clock was set since the last message."""
        last, self._last = self._last, arrival
        if last is None:
            return False
        change = arrival.clock_offset - last.clock_offset
        if not is_jump(change, abs(arrival.log_time - last.log_time - change)):
            return False
        direction, seconds = "back" if change < 0 else "forward", abs(change) / 1e9
        _log.warning("the system clock was set %s by %.3f s: recording continues in a new file", direction, seconds)
        return True

    def _is_over(self, file: RecordFile) -> bool:
        age = time.monotonic() - file.opened
        # the latched messages at the start leave at least half of the size to others; else each of these began a file
        most_bytes = max(self._most_bytes, self._latched_bytes + self._most_bytes // 2)
        over = (self._most_bytes and file.bytes >= most_bytes) or (self._most_seconds and age >= self._most_seconds)
        return file.full or bool(over)

    def _next_file(self) -> RecordFile | None:
        """Open another file, with the latched messages; return None until the next attempt is due. Raises `OSError`."""
        self.close()
        if time.monotonic() < self._retry:
            return None
        path = self._place.next()
        if self.trouble:
            free = room(path.parent)
            if free is not None and free < RESUME:
                self._retry = time.monotonic() + RETRY_SECONDS
                return None
        file = self.file = RecordFile(path, self._compression, self._about)
        self.count += 1
        self.last_path, self._flushed = path, time.monotonic()
        now = time.time_ns()
        for kept in self._latched.all():
            self._ensure_channel(file, kept)
            file.write(kept, now, again=True)
        self._latched_bytes = file.bytes
        if self.trouble:
            _log.warning("recording continues in %s", path)
        self.trouble = ""
        return file

    def _ensure_channel(self, file: RecordFile, arrival: RecordedMessage) -> None:
        key: ChannelKey = arrival.counts.key, arrival.origin
        if file.has(key):
            return
        topic, type_name, type_hash = arrival.counts.key
        definition = self._definitions.find(type_name, type_hash, _DEFINITION_SECONDS)
        if definition is None:
            _log.warning("%s: the definition of %s is unknown; it is recorded without one", topic, type_name)
        publishers = self._graph.publishers(topic)
        offered = tuple(p.qos for p in publishers if (p.type_name, p.origin) == (type_name, arrival.origin))
        tap = {"tap": topic} if tapped(topic)[0] else {}
        side = side_of(arrival.origin)
        file.channel(
            key,
            ChannelInfo(arrival.counts.name, type_name, type_hash, definition, offered, side, arrival.origin, tap),
        )

    def _failed(self, err: OSError) -> None:
        """Report the error, close the file, and schedule the attempt to open a new one."""
        first = not self.trouble
        where = self.file.path if self.file is not None else err.filename
        self.trouble = f"{where}: {err.strerror or err}"
        self._retry = time.monotonic() + RETRY_SECONDS
        if first:
            continues = "when there is space" if err.errno in _FULL else "as soon as one can be written"
            _log.error("recording stopped: %s; it continues in a new file %s", self.trouble, continues)
        self.close()
