"""The one error of the interface builder."""

from __future__ import annotations


class BuildError(Exception):
    """A message package cannot be built.

    Attributes:
        where: ``package/msg/Name.msg:line`` where the fault lies in a definition, else "".
        cure: what a person can do about it, "" where nothing is known to help.
    """

    def __init__(self, message: str, where: str = "", cure: str = "") -> None:
        text = f"{where}: {message}" if where else message
        super().__init__(f"{text}. {cure}" if cure else text)
        self.where = where
        self.cure = cure
