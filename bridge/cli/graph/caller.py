"""Service calls of verbs: discovery of the server, and the call."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

from bridge.cli.client import CliClient
from bridge.cli.messages import Types
from bridge.cli.output import CliError, clean
from bridge.hub.endpoints.calls import CallError
from bridge.hub.endpoints.services import HubClient
from bridge.messages.errors import ConversionError

WAIT_SECONDS = 5.0
_TYPE = re.compile(r"[A-Za-z]\w*(?:/\w+){1,2}", re.ASCII)


def type_and_values(words: list[str]) -> tuple[str, str]:
    """Split ``[TYPE] [VALUES]`` into the type, "" if missing, and the values' text; raises `CliError`."""
    if len(words) > 2:
        raise CliError(f"after the name come the type, if any, and the values in one word: quote {' '.join(words)!r}")
    typed = bool(words) and _TYPE.fullmatch(words[0]) is not None
    values = words[1:] if typed else words
    if len(values) > 1:
        raise CliError(f"{words[0]!r} is not a type: it should look like std_srvs/SetBool or std_srvs/srv/SetBool")
    return (words[0] if typed else ""), (values[0] if values else "{}")


class ServiceCaller:
    """Calls one service on the hub with JSON values; without a type it uses the server's.

    Raises `CliError` if no server of the type appears within `WAIT_SECONDS`, or the type is unknown.
    """

    def __init__(self, client: CliClient, types: Types, name: str, type_name: str = "") -> None:
        from bridge.messages.json import CallCodec

        self.name = name
        self.type_name, type_hash = _served(client, name, type_name)
        types.prepare_service(self.type_name, type_hash)
        self._codec = CallCodec(types.registry, self.type_name, type_hash)
        self._ready = threading.Event()
        self._client: HubClient = client.hub.client(name, self.type_name, type_hash, self._ready.set)
        while not self._client.ready:
            self._ready.clear()
            if not self._client.ready and not self._ready.wait(WAIT_SECONDS):
                self.close()
                raise CliError(f"the server of {name} does not accept calls from here")

    def call(self, values: dict[str, Any], done: Callable[[dict[str, Any] | CallError], None]) -> Callable[[], None]:
        """Call the service; ``done`` gets the reply or the error. Raises `CliError` if the values do not fit."""
        try:
            request = self._codec.request(values)
        except ConversionError as err:
            raise CliError(f"{self.type_name}: {err}") from None
        return self._client.call(request, lambda result: done(self._read(result)))

    def ask(
        self, values: dict[str, Any], seconds: float | None = None, check: Callable[[], None] = lambda: None
    ) -> dict[str, Any]:
        """Call and wait for the reply; raises `CliError`. An error of ``check``, called regularly, ends the call."""
        replies: SimpleQueue[dict[str, Any] | CallError] = SimpleQueue()
        abandon = self.call(values, replies.put)
        try:
            reply: dict[str, Any] | CallError | None = _get(replies, seconds, check)
        except BaseException:
            abandon()
            raise
        if reply is None:
            abandon()
            raise CliError(f"{self.name} has not answered in {seconds:g} s")
        if isinstance(reply, CallError):
            raise CliError(f"{self.name}: {clean(reply)}")
        return reply

    def close(self) -> None:
        """Close the client; unnecessary for a process that then exits."""
        self._client.close()

    def _read(self, result: bytes | CallError) -> dict[str, Any] | CallError:
        if isinstance(result, CallError):
            return result
        try:
            return self._codec.response_value(result)
        except ConversionError as err:
            return CallError(f"the reply is invalid: {err}")


def _get(queue: SimpleQueue[Any], seconds: float | None, check: Callable[[], None]) -> Any:
    """Wait for the next reply; return None after ``seconds``. Interruptible on every system."""
    from queue import Empty

    waited = 0.0
    while seconds is None or waited < seconds:
        check()
        step = 0.2 if seconds is None else min(0.2, seconds - waited)
        try:
            return queue.get(timeout=step)
        except Empty:
            waited += step
    return None


def _served(client: CliClient, name: str, wanted: str) -> tuple[str, str]:
    """Wait for a service's server on the hub; return its type and hash."""
    changed = threading.Event()
    unwatch = client.hub.graph.watch(changed.set)
    try:
        while True:
            served = {(e.type_name, e.type_hash) for e in client.hub.graph.servers(name)}
            fitting = sorted(entry for entry in served if wanted in ("", entry[0]))
            if len(fitting) > 1 and not wanted:
                raise CliError(f"{name} is served with several types: {', '.join(t for t, _ in fitting)}; name one")
            if fitting:
                return fitting[0]
            if not changed.wait(WAIT_SECONDS):
                break
            changed.clear()
    finally:
        unwatch()
    if served:
        raise CliError(f"{name} is {', '.join(sorted(t for t, _ in served))} on the hub, not {wanted}")
    raise CliError(f"{name} has no server on the hub; 'midspan explain {name}' shows why")
