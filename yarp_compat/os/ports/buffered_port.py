"""``BufferedPort``: reading and writing without blocking, and callbacks on the port's thread."""

from __future__ import annotations

import inspect
import logging
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, ClassVar

from yarp_compat.os.ports.connection import sender_profile
from yarp_compat.os.ports.contact import Contact
from yarp_compat.os.ports.contactable import Contactable
from yarp_compat.os.ports.inbox import Inbox
from yarp_compat.os.ports.port import answer
from yarp_compat.overriding import override
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import PortReader

log = logging.getLogger("yarp.os.BufferedPort")


class TypedReaderCallback:
    """The base class of callbacks for ``port.useCallback(callback)``, such as ``BottleCallback``."""

    def onRead(self, datum: Any, reader: Any = None) -> None:
        """Handle one message; ``reader`` is the port. It may be defined with only the first argument."""


class CallbackThread:
    """A thread that passes messages to a callback (an object with ``onRead``, or a function), under a lock.

    ``receive`` waits for the next content, and returns None at the end or when its argument returns true.
    ``port`` is passed to callbacks with a second argument.
    """

    def __init__(
        self,
        name: str,
        receive: Callable[[Callable[[], bool]], Any],
        callback: Any,
        port: Any,
        lock: AbstractContextManager[Any],
    ) -> None:
        self._receive = receive
        self._lock = lock
        self._call = _caller(getattr(callback, "onRead", callback), port)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"yarp callback {name}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while (content := self._receive(self._stopped.is_set)) is not None:
            try:
                with self._lock:
                    self._call(content)
            except Exception:
                log.exception("a callback failed; the port continues with the next message")

    def stop(self, wake: Callable[[], None]) -> None:
        """Stop the thread, and wait for a running callback unless it is the caller. ``wake`` wakes up ``receive``."""
        self._stopped.set()
        wake()
        if threading.current_thread() is not self._thread:
            self._thread.join()


def _caller(function: Callable[..., Any], port: Any) -> Callable[[Any], Any]:
    """Return the callback as a function of the content only."""
    try:
        inspect.signature(function).bind(None, None)
    except TypeError:
        return function
    return lambda content: function(content, port)


class BufferedPort(Contactable, TypedReaderCallback):
    """A port for one type of data, ``content``, that buffers received and written messages.

    A reader gets the newest message, or every message after `setStrict`. A written message replaces one that is still
    queued for a slow peer, except with `writeStrict`. ``BufferedPortBottle`` and similar classes have a fixed content.
    """

    CONTENT: ClassVar[type[Any] | None] = None

    def __init__(self, content: type[Any] | None = None) -> None:
        super().__init__()
        kind = content or self.CONTENT
        if kind is None:
            raise TypeError(
                "BufferedPort needs the class of its data: BufferedPort(yarp.Bottle), or BufferedPortBottle()"
            )
        self._content: type[Any] = kind
        self._type = self._type or getattr(kind, "TYPE", "")
        self._gate = self._inbox = Inbox()
        self._strict = False
        self._replier: PortReader | None = None
        self._callback: Any = None
        self._thread: CallbackThread | None = None
        self._last: Any = None
        self._last_envelope = ""
        self._prepared: Any = None
        self._spare: Any = None

    def prepare(self) -> Any:
        """Return the object to fill and `write`. It may still contain an earlier message: clear it if that matters."""
        self._prepared = self._spare if self._spare is not None else self._content()
        self._spare = None
        return self._prepared

    def unprepare(self) -> bool:
        """Discard the prepared object without writing it; return False if there is none to reuse."""
        self._spare, self._prepared = self._prepared or self._spare, None
        return self._spare is not None

    def write(self, forceStrict: bool = False) -> None:
        """Send the prepared object in place of queued messages, or with ``forceStrict`` after they have been sent."""
        data, self._prepared = self._prepared, None
        core = self._core
        if data is None:
            return
        self._spare = data
        if core is None or self._interrupted:
            return
        try:
            if forceStrict:
                core.wait_writes()
            core.write(data.to_wire, self._envelope, strict=forceStrict)
        except (WireError, OSError) as err:
            log.error("port %s cannot write: %s", core.name, err)

    def writeStrict(self) -> None:
        """Wait until earlier messages are sent, then send the prepared object, so that none is dropped."""
        self.write(True)

    def waitForWrite(self) -> None:
        """Wait until all written messages have been sent."""
        if self._core is not None:
            self._core.wait_writes()

    def read(self, shouldWait: bool = True) -> Any:
        """Return the newest message (in strict mode the oldest unread), or None; ``shouldWait``: wait for one."""
        if self._core is None or self._interrupted:
            return None
        self._last = self._next(wait=shouldWait)
        return self._last

    def _next(self, *, wait: bool, stopped: Callable[[], bool] | None = None) -> Any:
        """Return the next message of this port's type."""
        while True:
            message = self._inbox.pop(wait=wait, stopped=stopped)
            if message is None:
                return None
            content = self._content()
            try:
                content.from_wire(message.payload, sender_profile(message))
            except WireError as err:
                log.error("port %s: skipped a message from %s: %s", self.getName(), message.peer.route.source, err)
                continue
            self._last_envelope = message.envelope
            return content

    def lastRead(self) -> Any:
        """Return the message read last, or None."""
        return self._last

    def acquire(self) -> Any:
        """Return the message read last; the port never reuses it: every read returns a new object."""
        return self._last

    def release(self, handle: Any) -> None:
        """Do nothing: acquired messages need no release."""

    def getPendingReads(self) -> int:
        """Return the number of unread messages."""
        return len(self._inbox)

    def getEnvelope(self, envelope: Any) -> bool:
        """Read the envelope of the message read last; return False if it is missing or of another type."""
        try:
            envelope.from_text(self._last_envelope)
        except WireError:
            return False
        return bool(self._last_envelope)

    def setStrict(self, strict: bool = True) -> None:
        """Select whether `read` returns every message, or only the newest."""
        self._strict = self._inbox.strict = strict

    def isClosed(self) -> bool:
        """Return whether the port is closed."""
        return self._core is None

    def setReplier(self, reader: PortReader) -> None:
        """Let ``reader.read(connection)`` answer requests."""
        self._replier = reader

    setReader = setReplier

    @override
    def onRead(self, datum: Any, reader: Any = None) -> None:
        """Handle one message after ``useCallback()``; for derived classes to override."""

    def useCallback(self, callback: Any = None) -> None:
        """Pass each message to ``callback.onRead(message, port)``; by default to the port's own ``onRead``."""
        self.disableCallback()
        self._callback = self if callback is None else callback
        if self._core is not None:
            self._start_callback()

    def disableCallback(self) -> None:
        """Stop the callback: messages wait for `read`."""
        self._callback = None
        self._stop_callback()

    def _stop_callback(self) -> None:
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.stop(self._inbox.wake)

    def _start_callback(self) -> None:
        def next_message(stopped: Callable[[], bool]) -> Any:
            self._last = content = self._next(wait=True, stopped=stopped)
            return content

        self._thread = CallbackThread(self.getName(), next_message, self._callback, self, self._callback_lock)

    @override
    def _on_open(self) -> None:
        self._gate = self._inbox = Inbox()
        self._inbox.strict = self._strict
        if self._callback is not None:
            self._start_callback()

    @override
    def _on_closing(self) -> None:
        self._inbox.close()
        self._stop_callback()

    @override
    def _on_closed(self, core: PortCore) -> None:
        super()._on_closed(core)
        self._callback = None

    @override
    def _on_message(self, message: PortMessage) -> None:
        if message.wants_reply and self._replier is not None:
            with self._callback_lock:
                answer(self._replier, message, Contact(self.getName()))
        else:
            self._inbox.put(message)
