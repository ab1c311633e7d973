"""A device's methods as the answers of a service: what all of YARP's wrappers ("nws") do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue


class DeviceCalls:
    """Calls a device, which may be any object; what it lacks is not implemented.

    Its methods return their results, or None where that is all; or an outcome; or they raise `CallFailed`.

    Args:
        device: with methods under YARP's names.
    """

    def __init__(self, device: object) -> None:
        self._device = device

    def done(self, method: str, *arguments: Any) -> ReturnValue:
        """The outcome of a method that returns nothing."""
        returned = self._method(method)(*arguments)
        return returned if isinstance(returned, ReturnValue) else OK

    def found(self, method: str, *arguments: Any, lacking: str) -> Any:
        """What a method returns.

        Args:
            method: its name.
            arguments: its own.
            lacking: what is said where it returns None.
        """
        returned = self._method(method)(*arguments)
        if isinstance(returned, ReturnValue):
            raise CallFailed(returned.code if not returned else ReturnCode.METHOD_FAILED, lacking)
        if returned is None:
            raise CallFailed(ReturnCode.METHOD_FAILED, lacking)
        return returned

    def _method(self, name: str) -> Callable[..., Any]:
        method = getattr(self._device, name, None)
        if method is None:
            raise NotImplementedError(name)
        return method  # type: ignore[no-any-return] # any object's method
