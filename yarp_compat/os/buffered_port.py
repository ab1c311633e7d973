"""``BufferedPort`` and its kin: reading and writing that wait for nobody."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, ClassVar

from yarp_compat.os.callback import CallbackThread, TypedReaderCallback
from yarp_compat.os.connection import PortReader, recognised
from yarp_compat.os.contact import Contact
from yarp_compat.os.contactable import Contactable
from yarp_compat.os.inbox import Inbox
from yarp_compat.os.port import answer
from yarp_compat.ports.message import Message
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.errors import WireError

log = logging.getLogger("yarp.os.BufferedPort")


class BufferedPort(Contactable, TypedReaderCallback):
    """A port for one type of data that buffers what it reads and writes.

    A reader gets the newest message, unless `setStrict`; a writer's message takes the place of one that a slow peer has
    not taken yet, unless `writeStrict`.

    Args:
        content: the class of the data; ``BufferedPortBottle`` and its kin have theirs.
    """

    CONTENT: ClassVar[type[Any] | None] = None

    def __init__(self, content: type[Any] | None = None) -> None:
        super().__init__()
        made = content or self.CONTENT
        if made is None:
            msg = "BufferedPort needs the class of its data: BufferedPort(yarp.Bottle), or BufferedPortBottle()"
            raise TypeError(msg)
        self._content: type[Any] = made
        self._type = self._type or getattr(made, "TYPE", "")
        self._inbox = Inbox()
        self._strict = False
        self._replier: PortReader | None = None
        self._callback: Any = None
        self._thread: CallbackThread | None = None
        self._last: Any = None
        self._last_envelope = ""
        self._prepared: Any = None
        self._spare: Any = None

    # -- writing ------------------------------------------------------------------------------------------------------

    def prepare(self) -> Any:
        """The object to fill and then to `write`. It may hold what was written before: clear it where that matters."""
        self._prepared = self._spare if self._spare is not None else self._content()
        self._spare = None
        return self._prepared

    def unprepare(self) -> bool:
        """Give the prepared object back without writing it; False when there was none."""
        self._spare, self._prepared = self._prepared or self._spare, None
        return self._spare is not None

    def write(self, forceStrict: bool = False) -> None:
        """Send the prepared object; with ``forceStrict`` after what is still on its way, else instead of that."""
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
        """Send the prepared object after what is still on its way: none is lost."""
        self.write(True)

    def waitForWrite(self) -> None:
        """Wait until all that was written has been sent."""
        if self._core is not None:
            self._core.wait_writes()

    # -- reading ------------------------------------------------------------------------------------------------------

    def read(self, shouldWait: bool = True) -> Any:
        """The next message: the newest, or in strict mode the oldest not read yet.

        Args:
            shouldWait: wait for one, until the port is interrupted or closed.

        Returns:
            The message, or None.
        """
        if self._core is None or self._interrupted:
            return None
        self._last = self._next(wait=shouldWait)
        return self._last

    def _next(self, *, wait: bool, stopped: Callable[[], bool] | None = None) -> Any:
        """The next message that is of this port's type."""
        while True:
            message = self._inbox.take(wait=wait, stopped=stopped)
            if message is None:
                return None
            content = self._content()
            try:
                content.from_wire(message.payload, recognised(message))
            except WireError as err:
                log.error("port %s: a message from %s is skipped: %s", self.getName(), message.peer.route.source, err)
                continue
            self._last_envelope = message.envelope
            return content

    def lastRead(self) -> Any:
        """The message read last; None when there was none."""
        return self._last

    def acquire(self) -> Any:
        """Take the message read last out of the port's hands, where it is not anyway: every read gives a new object."""
        return self._last

    def release(self, handle: Any) -> None:
        """Give it back: nothing to do."""

    def getPendingReads(self) -> int:
        """How many messages wait to be read."""
        return len(self._inbox)

    def getEnvelope(self, envelope: Any) -> bool:
        """Read the envelope of the message read last; False when it had none, or another kind."""
        try:
            envelope.from_text(self._last_envelope)
        except WireError:
            return False
        return bool(self._last_envelope)

    def setStrict(self, strict: bool = True) -> None:
        """Whether every message is read, or the newest only."""
        self._strict = self._inbox.strict = strict

    def isClosed(self) -> bool:
        """Whether the port is closed."""
        return self._core is None

    def setReplier(self, reader: PortReader) -> None:
        """Have messages that want an answer taken by ``reader.read(connection)``."""
        self._replier = reader

    setReader = setReplier

    # -- callbacks ----------------------------------------------------------------------------------------------------

    def onRead(self, datum: Any, reader: Any = None) -> None:
        """Take one message after ``useCallback()``: for classes derived from this one."""

    def useCallback(self, callback: Any = None) -> None:
        """Have each message taken by ``callback.onRead(message, port)``; by the port's own ``onRead`` without one."""
        self.disableCallback()
        self._callback = self if callback is None else callback
        if self._core is not None:
            self._start_callback()

    def disableCallback(self) -> None:
        """Call nobody any more: messages wait for `read`."""
        self._callback = None
        self._stop_callback()

    def _stop_callback(self) -> None:
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.stop(self._inbox.wake)

    def _start_callback(self) -> None:
        def take(stopped: Callable[[], bool]) -> Any:
            self._last = content = self._next(wait=True, stopped=stopped)
            return content

        self._thread = CallbackThread(self.getName(), take, self._callback, self, self._callback_lock)

    # -- the port's life ----------------------------------------------------------------------------------------------

    def interrupt(self) -> None:
        """Let whoever waits for this port go; until `resume` it reads and writes nothing."""
        super().interrupt()
        self._inbox.interrupt()

    def resume(self) -> None:
        """Go on after `interrupt`."""
        self._inbox.resume()
        super().resume()

    def _began(self) -> None:
        self._inbox = Inbox()
        self._inbox.strict = self._strict
        if self._callback is not None:
            self._start_callback()

    def _ending(self) -> None:
        self._inbox.close()
        self._stop_callback()

    def _ended(self, core: PortCore) -> None:
        super()._ended(core)
        self._callback = None

    def _take(self, message: Message) -> None:
        if message.wants_reply and self._replier is not None:
            with self._callback_lock:
                answer(self._replier, message, Contact(self.getName()))
        else:
            self._inbox.put(message)
