"""Numbers at an address, for compiled functions: plain integers are handed over quicker than arrays are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

_declare: Any = intrinsic
_types: Any = types


def _pointer(element: Any, machine_type: Any) -> Callable[[int], Any]:
    """An intrinsic that takes an address for the start of a C array."""

    def pointer(_typing: Any, _address: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], machine_type.as_pointer())

        return _types.CPointer(element)(_types.int64), generate

    made: Callable[[int], Any] = _declare(pointer)
    return made


floats = _pointer(types.float64, ir.DoubleType())
"""The float64 at an address, by index. Nothing is checked."""

words = _pointer(types.int64, ir.IntType(64))
"""The int64 at an address, by index. Nothing is checked."""
