"""What YARP's clients ask of a module, on its thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from bridge.modules.loop import ANSWER_SECONDS, Loop
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode

T = TypeVar("T")


class Calls:
    """Does things on a module's thread, for threads of connections, and says to clients why one was not done.

    Args:
        loop: the module's.
        refusals: errors by which the module refuses what cannot be done now.
    """

    def __init__(self, loop: Loop, *refusals: type[Exception]) -> None:
        self._loop, self._refusals = loop, refusals

    def do(self, action: Callable[[], T]) -> T:
        """Do something, also after its client has given up: a stop always is."""
        return self._done(action, ANSWER_SECONDS, late=True)

    def move(self, action: Callable[[], T], seconds: float = ANSWER_SECONDS) -> T:
        """Do what moves the robot: never once its client was told, after so many seconds, that it is not done."""
        return self._done(action, seconds, late=False)

    def _done(self, action: Callable[[], T], seconds: float, *, late: bool) -> T:
        try:
            found: T = self._loop.call(action, seconds, late=late)
        except self._refusals as err:
            raise CallFailed(ReturnCode.METHOD_FAILED, str(err)) from None
        except TimeoutError as err:
            raise CallFailed(ReturnCode.NOT_READY, str(err)) from None
        return found
