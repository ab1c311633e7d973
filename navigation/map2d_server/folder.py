"""The one folder whose files clients may name."""

from __future__ import annotations

from pathlib import Path

_LONGEST = 200


class MapsFolder:
    """Turns what a client calls a file into a path. There is no other folder for it, and none below this one.

    Args:
        path: the folder; made when something is written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def file(self, name: str, *suffixes: str) -> Path:
        """The file of a name.

        Args:
            name: as the client said it.
            suffixes: one of which the name must have, such as ``.yaml``; the first is added to a name without any.

        Raises:
            ValueError: it is no plain name, or leads out of the folder; the text is for the client's user.
        """
        if not name or len(name.encode(errors="replace")) > _LONGEST or not name.isprintable():
            raise ValueError(f"{name[:60]!r} is no name of a file: it has 1 to {_LONGEST} bytes that can be printed")
        if name[0] == "." or any(sign in name for sign in "/\\:"):
            raise ValueError(
                f"{name[:60]!r} is refused: give the plain name of a file in the maps folder, without a path"
            )
        if suffixes and not name.lower().endswith(suffixes):
            if "." in name:
                raise ValueError(f"{name[:60]!r} is refused: its name should end in {' or '.join(suffixes)}")
            name += suffixes[0]
        found = self.path / name
        if found.is_symlink() and not found.resolve().is_relative_to(self.path.resolve()):
            raise ValueError(f"{name[:60]!r} is refused: it is a link that leads out of the maps folder")
        return found

    def existing(self, name: str, *suffixes: str) -> Path:
        """As :meth:`file`, of a file that is there; without a suffix the first that is there with one.

        Raises:
            FileNotFoundError: there is none.
        """
        found = self.file(name, *suffixes)
        others = [found.with_name(name + suffix) for suffix in suffixes if found.name != name]
        for each in (found, *others):
            if each.is_file():
                return self.file(each.name, *suffixes)
        raise FileNotFoundError(f"there is no file {name!r} in the maps folder")

    def new(self, name: str, *suffixes: str) -> Path:
        """As :meth:`file`, of one that is to be written: the folder is there afterwards."""
        found = self.file(name, *suffixes)
        self.path.mkdir(parents=True, exist_ok=True)
        return found
