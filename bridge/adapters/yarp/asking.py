"""An RPC port of a YARP program as a service: each call that is under way has a connection of its own."""

from __future__ import annotations

import itertools
import os
import threading
from collections import deque

from bridge.adapters.yarp.call_bottles import CallBottles
from bridge.adapters.yarp.names import OWNER
from bridge.hub.call import Abandon, CallError, Done
from bridge.messages.errors import ConversionError
from yarp_compat.naming.client import NameClient
from yarp_compat.ports.naming import Unregistered
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.errors import WireError

MOST = 64
"""Calls of one port that are under way at most."""

_NUMBERS = itertools.count(1)
_IDLE = 4
"""Connections that are kept for the next calls."""


class PortCaller:
    """Calls one RPC port; see `bridge.adapters.base.EdgeCaller`.

    Args:
        naming: the name server.
        port: whose RPC port.
        carrier: "" for the usual one.
        bottles: the converter.
        limit: bytes of the largest reply.
    """

    def __init__(self, naming: NameClient, port: str, carrier: str, bottles: CallBottles, limit: int) -> None:
        self._naming, self._names, self._port = naming, Unregistered(naming), port
        self._target = f"{carrier}:/{port}" if carrier else port
        self._bottles, self._limit = bottles, limit
        self._lock = threading.Lock()
        self._idle: deque[PortCore] = deque()
        self._calls: set[_Asked] = set()
        self._closed = False

    def call(self, request: bytes, done: Done) -> Abandon:
        """Begin a call; see `EdgeCaller.call`."""
        with self._lock:
            trouble = ""
            if self._closed:
                trouble = f"{self._port} is called no more"
            elif len(self._calls) >= MOST:
                trouble = f"{self._port} is busy: {MOST} calls are under way"
            else:
                asked = _Asked(self, request, done)
                self._calls.add(asked)
                core = self._idle.popleft() if self._idle else None
        if trouble:
            done(CallError(trouble))
            return _nothing
        threading.Thread(target=asked.run, args=(core,), name=f"midspan-yarp-call {self._port}", daemon=True).start()
        return asked.abandon

    def close(self) -> None:
        """End every call with an error; see `EdgeCaller.close`."""
        with self._lock:
            self._closed = True
            calls, idle = list(self._calls), list(self._idle)
            self._idle.clear()
        for asked in calls:
            asked.end(CallError(f"{self._port} is called no more"))
        for core in idle:
            core.close()

    def connection(self) -> PortCore:
        """A port of ours that is connected to theirs; raises `OSError`."""
        if self._naming.get_property(self._port, OWNER):
            msg = f"{self._port} is a port of Midspan's; what it serves is not taken up again"
            raise ConnectionRefusedError(msg)
        name = f"/midspan/call{next(_NUMBERS)}/{os.getpid()}"
        core = PortCore(name, naming=self._names, rpc=True, is_input=False, limit=self._limit)
        core.open()
        done, told = core.add_output(self._target)
        if not done:
            core.close()
            raise ConnectionRefusedError(told)
        return core

    def ask(self, core: PortCore, request: bytes) -> bytes:
        """One request and its reply, as the hub's bytes.

        Raises:
            OSError: the connection broke.
            WireError: the reply is no Bottle.
            ConversionError: it is none of this service's.
            CallError: it tells of a failure.
        """
        profile = core.answers_in
        reply = core.request(self._bottles.request_to_yarp(request, profile))
        return self._bottles.reply_to_hub(reply, profile)

    def over(self, asked: _Asked, core: PortCore | None) -> None:
        """A call ended; its connection may serve the next one."""
        with self._lock:
            self._calls.discard(asked)
            keep = core is not None and not self._closed and len(self._idle) < _IDLE
            if keep and core is not None:
                self._idle.append(core)
        if core is not None and not keep:
            core.close()


class _Asked:
    """One call, on a thread of its own."""

    def __init__(self, caller: PortCaller, request: bytes, done: Done) -> None:
        self._caller, self._request = caller, request
        self._lock = threading.Lock()
        self._done: Done | None = done
        self._core: PortCore | None = None

    def run(self, core: PortCore | None) -> None:
        """Ask and tell of the reply. A connection from an earlier call may have died since: then a new one is made."""
        result: bytes | CallError
        fresh: PortCore | None = None
        try:
            if core is not None and not core.connections.outputs:
                core.close()
                core = None
            fresh = core or self._caller.connection()
            with self._lock:
                self._core = fresh if self._done is not None else None
            if self._core is None:
                self._caller.over(self, fresh)
                return
            result = self._caller.ask(fresh, self._request)
        except CallError as err:
            result = err
        except ConversionError as err:
            result = CallError(f"the reply is none: {err}")
        except (OSError, WireError) as err:
            result = CallError(f"the port left before it answered: {err}")
            if fresh is not None:
                fresh.close()
                fresh = None
        with self._lock:
            self._core = None
        self.end(result)
        self._caller.over(self, fresh)

    def abandon(self) -> None:
        """Nobody waits for the reply any more."""
        with self._lock:
            self._done = None
            core, self._core = self._core, None
        if core is not None:
            core.close()

    def end(self, result: bytes | CallError) -> None:
        """Tell of the end, once."""
        with self._lock:
            done, self._done = self._done, None
            core = self._core if isinstance(result, CallError) else None
        if core is not None:
            core.close()
        if done is not None:
            done(result)


def _nothing() -> None:
    """The call is over."""
