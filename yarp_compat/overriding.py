"""The decorator ``override`` for type checkers, because Python 3.11 lacks it and this package depends only on numpy."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from typing_extensions import override
else:
    Method = TypeVar("Method")

    def override(method: Method) -> Method:
        """Return the method unchanged."""
        return method


__all__ = ["override"]
