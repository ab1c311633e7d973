"""A service of the hub as an RPC port: what YARP programs ask it is a call, and the reply is theirs."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial

from bridge.adapters.base import MadeBy
from bridge.adapters.yarp.call_bottles import CallBottles
from bridge.hub.call import Abandon, Call, CallError
from bridge.messages.errors import ConversionError
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.message import Message

_log = logging.getLogger(__name__)

Refused = Callable[[str, str, str], None]


class ServedPort:
    """What an RPC port does with requests. Each waits on its connection's own thread; other connections go on.

    Args:
        service: the service's name on the side.
        bottles: the converter.
        call: the service.
        made_by: tells who made a port.
        refused: told of a request that is none: service, reason, why.
    """

    def __init__(
        self, service: str, bottles: CallBottles, call: Call, made_by: Callable[[str], MadeBy], refused: Refused
    ) -> None:
        self.service = service
        self._bottles, self._call, self._made_by, self._refused = bottles, call, made_by, refused
        self._lock = threading.Lock()
        self._waiting: dict[Message, Abandon] = {}
        self._closed = False

    def on_message(self, message: Message) -> None:
        """Take a request; on the thread of its connection."""
        peer = message.peer
        if self._made_by(peer.route.source) is MadeBy.MIDSPAN:
            self._say(message, CallError("a call of Midspan's own does not come back to it"))
            return
        try:
            request, peer.profile = self._bottles.request_to_hub(message.payload, peer.profile)
        except ConversionError as err:
            self._refused(self.service, "bad", f"from {peer.route.source}: {err}")
            self._say(message, CallError(str(err)))
            return
        message.later()
        with self._lock:
            closed = self._closed
            if not closed:
                self._waiting[message] = _nothing
        if closed:
            self._say(message, CallError(f"{self.service} is served no more"))
            return
        abandon = self._call(request, partial(self._answer, message))
        with self._lock:
            if waits := message in self._waiting:
                self._waiting[message] = abandon
        if not waits:  # who asked went as the call began, or the service did
            abandon()

    def look(self) -> None:
        """Abandon the calls whose callers have gone."""
        with self._lock:
            waiting = list(self._waiting)
        for message in waiting:
            peer = message.peer
            if isinstance(peer, Input) and peer.is_gone:
                abandon = self._forget(message)
                message.give_up()
                if abandon is not None:
                    abandon()

    def close(self) -> None:
        """End all calls with an error."""
        with self._lock:
            self._closed = True
            waiting, self._waiting = self._waiting, {}
        for message, abandon in waiting.items():
            abandon()
            self._say(message, CallError(f"{self.service} is served no more"))

    def _answer(self, message: Message, result: bytes | CallError) -> None:
        if self._forget(message) is not None:
            self._say(message, result)

    def _forget(self, message: Message) -> Abandon | None:
        with self._lock:
            return self._waiting.pop(message, None)

    def _say(self, message: Message, result: bytes | CallError) -> None:
        profile = message.peer.profile
        try:
            reply = self._bottles.reply_to_yarp(result, profile)
        except ConversionError as err:
            _log.warning("%s: the reply cannot be said on YARP: %s", self.service, err)
            reply = self._bottles.reply_to_yarp(CallError(str(err)), profile)
        message.reply(reply)


def _nothing() -> None:
    """The call is only beginning."""
