"""Records selected topics of the hub: subscribes to them, and writes their messages on a separate thread.

Messages that the status counts as written can be read even if the process is killed: chunks are closed after a
megabyte or a second. When the disk is full, the file is closed, messages are dropped and counted, and recording
continues in a new file as soon as space is free.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

from bridge.bags.mcap_writer import ChannelInfo
from bridge.client.topics import HubTopic, HubTopics, TopicKey
from bridge.config.sections.record import RecordSection
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from bridge.record.arrivals import ArrivalQueue, RecordedMessage, TopicCounts
from bridge.record.file import RESUME, ChannelKey, RecordFile, room, total
from bridge.record.latched import LatchedState
from bridge.record.places import RecordPlace
from bridge.record.ring import Ring
from bridge.record.selection import Selection, side_of, tapped

_log = logging.getLogger("midspan.record")

FLUSH_SECONDS = 1.0
GATHER_SECONDS = 0.05
"""Messages are batched for this long before they are written, unless they are many megabytes."""

GONE_SECONDS = 10.0
"""A topic without publishers stays subscribed for this long, since its last messages may come after that news."""

MAX_TOPICS = 10_000

RETRY_SECONDS = 5.0
"""Delay before a new file after a failed one."""

STILL_SECONDS = 30.0
"""Without a step for this long, the writer thread counts as hanging."""

_DEFINITION_SECONDS = 2.5
_COMMAND_SECONDS = 10.0


class Recorder:
    """One recording. Safe to use from any thread.

    Args:
        hub: stays open.
        registry: of types.
        section: the configuration.
        place: names the files.
        about: metadata of each file.
        changed: called on a thread of zenoh after a change of the graph, to have `refresh` called.

    Attributes:
        topics: of the hub.
        trouble: the reason why nothing is written, "" while recording works.
    """

    def __init__(
        self, hub: Hub, registry: Registry, section: RecordSection, place: RecordPlace, about: dict[str, str],
        changed: Callable[[], None],
    ) -> None:  # fmt: skip
        self._hub, self._section, self._place, self._about = hub, section, place, about
        self.selection = Selection(section)
        self.topics = HubTopics(hub, registry, changed, taps=True)
        self.trouble = ""
        self._counts: dict[TopicKey, TopicCounts] = {}
        self._queue = ArrivalQueue(section.queue << 20)
        self._latched = LatchedState(hub.graph)
        self._commands: deque[tuple[Future[Any], Callable[[], Any]]] = deque()
        self._file: RecordFile | None = None
        self._on = self._ending = False
        self._subscribing = threading.Lock()
        self._gone: dict[TopicKey, float] = {}
        self._left = [0, 0]
        self._flushed = self._retry = 0.0
        self._last_step = time.monotonic()
        self._closed_files = 0
        self._last_path: Path | None = None
        ring = place if isinstance(place, Ring) else None
        self._most_bytes = ring.segment_bytes if ring else section.split.size << 20
        self._most_seconds = ring.segment_seconds if ring else section.split.seconds
        self._thread = threading.Thread(target=self._run, name="midspan-record-write", daemon=True)
        self._thread.start()

    # -- subscriptions -------------------------------------------------------------------------------------------------

    def refresh(self) -> dict[TopicKey, HubTopic]:
        """Subscribe to new selected topics, drop those that left the hub, and return all topics of the hub."""
        with self._subscribing:
            topics = self.topics.refresh()
            if not self._on:
                return topics
            subscribed = {end.key for end in self.topics.subscribed()}
            for key, topic in topics.items():
                if key not in subscribed and self.selection.wants(topic):
                    self._subscribe(topic)
            now = time.monotonic()
            self._gone = {key: self._gone.get(key, now) for key in subscribed - topics.keys()}
            for key in [key for key, since in self._gone.items() if now - since > GONE_SECONDS]:
                del self._gone[key]
                self._unsubscribe(key)
            return topics

    def _subscribe(self, topic: HubTopic) -> None:
        key = topic.key
        counts = self._counts.get(key)
        if counts is None:
            if len(self._counts) >= MAX_TOPICS:
                _log.warning("%s is not recorded: at most %d topics are", key.topic, MAX_TOPICS)
                return
            counts = self._counts[key] = TopicCounts(tapped(key.topic)[1], key)
        self.topics.definitions.find(*key[1:])  # requests a definition from other nodes early
        end = self.topics.subscribe(topic, partial(self._on_sample, counts))
        if end.trouble:
            _log.warning("%s is not recorded: %s", key.topic, end.trouble)

    def _unsubscribe(self, key: TopicKey) -> None:
        end = self.topics.unsubscribe(key)
        if end is not None:
            self._left[0] += end.lost
            self._left[1] += end.refused

    def _on_sample(self, counts: TopicCounts, sample: HubSample) -> None:
        """Queue a message, on a thread of zenoh."""
        now = time.time_ns()
        origin = self.topics.origin(sample)
        if not self.selection.origin(origin):
            return
        if not self._queue.has_room(len(sample.payload)):
            counts.dropped["queue"] += 1
            return
        sent = sample.source_time_ns if sample.source_time_ns > 0 else now
        # copied, since the sender's shared memory is small
        self._queue.put(RecordedMessage(counts, sample.gid, origin, sample.sequence, now, sent, sample.data()))

    # -- commands ------------------------------------------------------------------------------------------------------

    def begin(self) -> Path | None:
        """Start or continue, and return the file. Raises `OSError` if it cannot be created, which is retried."""
        self._on = True
        self.refresh()
        path: Path | None = self._do(self._open_now)
        return path

    def pause(self) -> Path | None:
        """Unsubscribe from all topics, and close and return the file; `begin` continues in another one."""
        with self._subscribing:
            self._on = False
            for topic in self.topics.subscribed():
                self._unsubscribe(topic.key)
        path: Path | None = self._do(self._close_file)
        return path

    def split(self) -> Path | None:
        """Close and return the file, None if none is open; the next message starts another one."""
        path: Path | None = self._do(self._close_file)
        return path

    def trigger(self, why: str) -> Future[Path | None]:
        """Keep the ring's files: results in the folder, None for an empty ring, or `OSError`; returns at once."""
        return self._post(partial(self._keep, why))

    def _post(self, action: Callable[[], Any]) -> Future[Any]:
        future: Future[Any] = Future()
        self._commands.append((future, action))
        self._queue.wake()
        return future

    def _do(self, action: Callable[[], Any]) -> Any:
        return self._post(action).result(_COMMAND_SECONDS)

    def close(self) -> None:
        """Write all waiting messages while that makes progress, and stop. Safe to call twice."""
        with self._subscribing:
            self._on = False
            self.topics.close()
        self._ending = True
        self._queue.wake()
        while self._thread.is_alive() and time.monotonic() - self._last_step < _COMMAND_SECONDS:
            self._thread.join(0.5)

    # -- the writer thread ---------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            ending = self._ending
            waiting = self._queue.pop_all(0.0 if self._commands or ending else GATHER_SECONDS)
            while waiting:
                self._last_step = time.monotonic()
                arrival = waiting.popleft()
                self._write(arrival)
                self._queue.wrote(arrival)
            self._run_commands()
            self._run_periodic()
            self._last_step = time.monotonic()
            if ending:
                break
        with contextlib.suppress(OSError):
            self._close_file()
        if isinstance(self._place, Ring):
            self._place.discard()

    def _run_commands(self) -> None:
        while self._commands:
            future, action = self._commands.popleft()
            try:
                future.set_result(action())
            except Exception as err:  # the caller gets the error
                _log.debug("a command failed", exc_info=True)
                future.set_exception(err)

    def _write(self, arrival: RecordedMessage) -> None:
        if self._file is None and not (self._on or self._ending):
            return  # received just before the pause
        try:
            file = self._file if self._file is not None and not self._is_over(self._file) else self._next_file()
            if file is None:
                arrival.counts.dropped["disk"] += 1
                return
            self._have_channel(file, arrival)
            file.write(arrival, arrival.log_time)
        except OSError as err:
            arrival.counts.dropped["disk"] += 1
            self._failed(err)
        else:
            self._latched.saw(arrival)

    def _is_over(self, file: RecordFile) -> bool:
        age = time.monotonic() - file.opened
        over = (self._most_bytes and file.bytes >= self._most_bytes) or (
            self._most_seconds and age >= self._most_seconds
        )
        return file.full or bool(over)

    def _next_file(self) -> RecordFile | None:
        """Open another file, with the latched messages; None before the next attempt is due. Raises `OSError`."""
        self._close_file()
        if time.monotonic() < self._retry:
            return None
        path = self._place.next()
        if self.trouble:
            free = room(path.parent)
            if free is not None and free < RESUME:
                self._retry = time.monotonic() + RETRY_SECONDS
                return None
        file = self._file = RecordFile(path, self._section.compression, self._about)
        self._last_path, self._flushed = path, time.monotonic()
        now = time.time_ns()
        for kept in self._latched.all():
            self._have_channel(file, kept)
            file.write(kept, now, again=True)
        if self.trouble:
            _log.warning("recording continues in %s", path)
        self.trouble = ""
        return file

    def _open_now(self) -> Path | None:
        self._retry = 0.0
        try:
            file = self._file or self._next_file()
        except OSError as err:
            self._failed(err)
            raise
        return file.path if file is not None else None

    def _have_channel(self, file: RecordFile, arrival: RecordedMessage) -> None:
        key: ChannelKey = arrival.counts.key, arrival.origin
        if file.has(key):
            return
        topic, type_name, type_hash = arrival.counts.key
        definition = self.topics.definitions.find(type_name, type_hash, _DEFINITION_SECONDS)
        if definition is None:
            _log.warning("%s: the definition of %s is unknown; it is recorded without one", topic, type_name)
        publishers = self._hub.graph.publishers(topic)
        offered = tuple(p.qos for p in publishers if (p.type_name, p.origin) == (type_name, arrival.origin))
        tap = {"tap": topic} if tapped(topic)[0] else {}
        side = side_of(arrival.origin)
        file.channel(
            key,
            ChannelInfo(arrival.counts.name, type_name, type_hash, definition, offered, side, arrival.origin, tap),
        )

    def _run_periodic(self) -> None:
        now = time.monotonic()
        file = self._file
        if file is not None and now - self._flushed >= FLUSH_SECONDS:
            self._flushed = now
            try:
                file.flush()
            except OSError as err:
                self._failed(err)
        if isinstance(self._place, Ring):
            self._place.prune()
        if self._file is None and self._on and self.trouble and now >= self._retry:
            try:
                self._next_file()
            except OSError as err:
                self._failed(err)

    def _failed(self, err: OSError) -> None:
        """Close the file after its last complete chunk; a new one is tried later."""
        first = not self.trouble
        where = self._file.path if self._file is not None else err.filename
        self.trouble = f"{where}: {err.strerror or err}"
        self._retry = time.monotonic() + RETRY_SECONDS
        if first:
            _log.error("recording stops: %s; it continues in a new file when space is free", self.trouble)
        self._close_file()

    def _close_file(self, ending: dict[str, str] | None = None) -> Path | None:
        """Close the file, with its summary if space is free."""
        file, self._file = self._file, None
        if file is None:
            return None
        self._closed_files += 1
        try:
            try:
                written = file.close(ending)
            except OSError as err:
                _log.warning("%s ends without its summary: %s", file.path, err.strerror or err)
                written = file.abandon()
            self._place.closed(written)
        except OSError as err:
            _log.error("%s: %s", file.path, err.strerror or err)
        return file.path

    def _keep(self, why: str) -> Path | None:
        if not isinstance(self._place, Ring):
            raise OSError(22, "the recording has no ring (record.ring.seconds)")
        self._close_file({"trigger": why, "time": str(time.time_ns())})
        kept = self._place.keep()
        if kept is not None:
            _log.info("%s: the ring is kept in %s", why, kept)
            self._last_path = kept
        return kept

    def computes(self) -> None:
        """Raise `RuntimeError` if the writer thread has exited, and `TimeoutError` if it hangs."""
        if not self._thread.is_alive() and not self._ending:
            raise RuntimeError("the writer thread has exited")
        still = time.monotonic() - self._last_step
        if still > STILL_SECONDS:
            raise TimeoutError(f"the writer thread has hung for {still:.0f} s: is the disk unreachable?")

    # -- status --------------------------------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Return the status document: written messages, and dropped ones by reason."""
        file = self._file
        counts = list(self._counts.values())
        messages, size, dropped = total(counts)
        subscriptions = self.topics.subscribed()
        lost = self._left[0] + sum(item.lost for item in subscriptions)
        refused = self._left[1] + sum(item.refused for item in subscriptions)
        dropped |= {reason: count for reason, count in (("lost", lost), ("refused", refused)) if count}
        return {
            "state": "blocked" if self.trouble else "recording" if self._on else "stopped",
            "file": str(file.path if file is not None else self._last_path or ""),
            "file_bytes": file.safe if file is not None else 0,
            "file_messages": file.messages if file is not None else 0,
            "files": self._closed_files + (file is not None),
            "ring": isinstance(self._place, Ring),
            "messages": messages,
            "bytes": size,
            "dropped": dropped,
            "error": self.trouble,
            "topics": [item.as_dict() for item in counts],
        }
