"""The commands and queries of pages: their arguments and threads. Each command is logged with its client."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Any

from bridge.client.errors import ClientError
from bridge.concurrency import WorkerPool
from bridge.hub.errors import HubError
from bridge.stores.entry import StoreError

_log = logging.getLogger("midspan.web")

BEGIN_SECONDS = 3.0
"""A call (except a stop) is not executed if it has waited this long for other calls."""
THREADS = 4
"""Number of concurrent calls, without slow verbs and stops."""
_STOP_THREADS = 2
_SLOW_THREADS = 3


class VerbError(RuntimeError):
    """A page's call failed; the text is the reason."""


@dataclass(frozen=True)
class PageVerb:
    """One verb: its required and optional arguments, each with a check, and its function.

    A ``slow`` verb may take long, and runs on separate threads. A verb that ``drives`` the robot is not executed if a
    stop began while it waited.
    """

    run: Callable[..., Any]
    needs: Mapping[str, Callable[[Any], Any]]
    may: Mapping[str, Callable[[Any], Any]]
    commands: bool = True
    stops: bool = False
    drives: bool = False
    logged: bool = True  #: applies to commands
    slow: bool = False


def number_between(least: float, most: float, unit: str = "") -> Callable[[Any], float]:
    """Return the check of a number within limits; ``unit`` is part of the error."""

    def check(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
            raise ValueError(f"must be a number{unit} between {least:,.15g} and {most:,.15g}")
        return float(value)

    return check


MOST_NUMBER = 1e6
number_of = number_between(-MOST_NUMBER, MOST_NUMBER)
"""Check a position in meters or a heading in radians."""


def name_of(value: Any) -> str:
    """Check a name."""
    if not isinstance(value, str) or not value.strip() or len(value) > 255:
        raise ValueError("must be a name of up to 255 characters")
    return value.strip()


def truth_of(value: Any) -> bool:
    """Check a bool."""
    if value is True or value is False:
        return bool(value)
    raise ValueError("must be true or false")


class Verbs:
    """Runs the verbs. `begin` may be called on any thread.

    Args:
        post: queues a function for the module's thread.
        before: by verb, a function that is called on the module's thread before the verb starts.

    Attributes:
        known: the verbs that pages may call, by name.
    """

    def __init__(
        self,
        known: Mapping[str, PageVerb],
        post: Callable[[Callable[[], None]], object],
        before: Mapping[str, Callable[[], None]],
    ) -> None:
        self.known, self._post, self._before = known, post, before
        self._pool = WorkerPool(THREADS, "midspan-web-call")
        self._slow = WorkerPool(_SLOW_THREADS, "midspan-web-slow")
        stops = [name for name, verb in known.items() if verb.stops]
        self._stops = {name: WorkerPool(_STOP_THREADS, f"midspan-web-{name}") for name in stops}
        self._lock = threading.Lock()
        self._newest: dict[str, Future[Any]] = {}
        self._begun_stops = 0

    def is_stop(self, verb: str) -> bool:
        """Return whether a verb stops robots; its calls have separate threads, and never expire while they wait."""
        return verb in self.known and self.known[verb].stops

    def is_command(self, verb: str) -> bool:
        """Return whether a verb is a command, which needs the role ``drive``."""
        return verb in self.known and self.known[verb].commands

    def begin(self, verb: str, args: Mapping[str, Any], who: str) -> Future[Any]:
        """Run a verb on a thread that may block; the future has the result or a `VerbError`.

        Raises `VerbError` at once if the verb is unknown or an argument is invalid.
        """
        page_verb = self.known.get(verb)
        if page_verb is None:
            raise VerbError(f"unknown verb {verb[:80]!r}; known: {', '.join(self.known)}")
        checked = _check_arguments(verb, page_verb, args)
        if page_verb.commands and page_verb.logged:
            arguments = " ".join(f"{key}={value!r}"[:100] for key, value in args.items())
            _log.info("%s: %s %s", who, verb, arguments)
        if page_verb.stops:
            with self._lock:
                self._begun_stops += 1
        if verb in self._before:
            self._post(self._before[verb])
        job = partial(_run, page_verb.run, checked, math.inf if page_verb.stops else time.monotonic() + BEGIN_SECONDS)
        if page_verb.stops:
            return self._begin_stop(verb, job)
        if page_verb.drives:
            job = partial(self._drive, job, self._begun_stops)
        return (self._slow if page_verb.slow else self._pool).submit(job)

    def _drive(self, job: Callable[[], Any], begun_stops: int) -> Any:
        """Run a verb that drives the robot, unless a stop has begun since: the robot must not drive after a stop."""
        if self._begun_stops != begun_stops:
            raise VerbError("not executed: a stop or a pause was requested while other calls delayed it")
        return job()

    def _begin_stop(self, verb: str, job: Callable[[], Any]) -> Future[Any]:
        """Run a stop without waiting for other verbs; while two stops of its kind run, further calls share the next."""
        with self._lock:
            newest = self._newest.get(verb)
            if newest is None or newest.running() or newest.done():
                newest = self._newest[verb] = self._stops[verb].submit(job)
            return newest

    def close(self) -> None:
        self._pool.close(1.0)
        self._slow.close(1.0)
        for pool in self._stops.values():
            pool.close(1.0)


def _run(action: Callable[..., Any], args: dict[str, Any], latest: float) -> Any:
    if time.monotonic() > latest:  # a late start would be unexpected
        raise VerbError(f"not executed: other calls delayed it by more than {BEGIN_SECONDS:g} s; try again")
    try:
        return action(**args)
    except (ClientError, HubError, StoreError, TimeoutError) as err:
        raise VerbError(str(err)) from None


def _check_arguments(verb: str, page_verb: PageVerb, args: Mapping[str, Any]) -> dict[str, Any]:
    known = {**page_verb.needs, **page_verb.may}
    for key in args:
        if key not in known:
            raise VerbError(f"{verb} has no argument {str(key)[:80]!r}; it has {', '.join(known) or 'none'}")
    for key in page_verb.needs:
        if key not in args:
            raise VerbError(f"{verb} needs {key}")
    checked = {}
    for key, value in args.items():
        try:
            checked[key] = known[key](value)
        except ValueError as err:
            raise VerbError(f"{verb}: {key} {err}, not {value!r:.80}") from None
    return checked
