"""Property: values under keys, from text, command lines and configuration files (`yarp/os/Property.h`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from yarp_compat.os import arguments, config_text
from yarp_compat.os.bottle import Bottle
from yarp_compat.os.plain import plain_of
from yarp_compat.os.searchable import Searchable
from yarp_compat.os.value import NULL, Value
from yarp_compat.wire.binary import decode_prefix, encode_parts
from yarp_compat.wire.decoder import dict_of
from yarp_compat.wire.encoder import entries_of, entry_values
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.text import from_text, to_text
from yarp_compat.wire.values import Group

if TYPE_CHECKING:
    from yarp_compat.wire.reader import Reader
    from yarp_compat.wire.writer import Writer


class Property(Portable, Searchable):
    """Values under keys.

    YARP's way: ``p.put("rate", 10); p.find("rate").asInt32()``. Python's: ``p["rate"]``, ``dict(p)``, where values are
    plain ones, as in a dict of `yarp_compat.wire.values`.

    Args:
        content: the text form, another Property, or plain values under their keys; they are copied.
    """

    def __init__(self, content: str | Property | Mapping[str, Any] = "") -> None:
        self._entries: dict[str, Any] = (
            dict_of(from_text(content)) if isinstance(content, str) else plain_of(dict(content.items()))
        )

    @classmethod
    def of(cls, entries: dict[str, Any]) -> Property:
        """The Property of these plain values: the same dict, not a copy."""
        made = object.__new__(cls)
        made._entries = entries
        return made

    @property
    def plain(self) -> dict[str, Any]:
        """The dict of plain values itself."""
        return self._entries

    # to put and find values

    def put(self, key: str, value: Any) -> None:
        """Put a value under a key; a bool is an int, as YARP's bindings take it."""
        made = plain_of(int(value) if isinstance(value, bool) else value)
        self._entries[key] = () if made is None else made

    def addGroup(self, key: str) -> Property:
        """Put an empty group under a key, and return it to be filled."""
        group = Group()
        self._entries[key] = group
        return Property.of(group)

    def unput(self, key: str) -> None:
        """Remove a key."""
        self._entries.pop(key, None)

    def clear(self) -> None:
        """Remove all."""
        self._entries.clear()

    def find(self, key: str) -> Value:
        """The value under a key; null where there is none."""
        values = entry_values(self._entries.get(key, ()))
        return Value.of(values[0]) if values else NULL

    def findGroup(self, key: str) -> Bottle:
        """A key and its values, in a Bottle of their own; a null Bottle where there is none."""
        if key not in self._entries:
            return Bottle.getNullBottle()
        own = next(one for one in self._entries if one == key)  # which may stand for a number
        return Bottle.of(*entries_of({own: self._entries[key]}))

    # where values come from

    def toString(self) -> str:
        """The text form, sorted by keys."""
        return to_text(entries_of(self._entries))

    def fromString(self, text: str, wipe: bool = True) -> None:
        """Take what a text says: lists, each a key and its values.

        Args:
            text: the text form.
            wipe: whether to remove first what there is; so in the other methods.
        """
        self._take(dict_of(from_text(text)), wipe)

    def fromCommand(self, argv: Sequence[str], skipFirst: bool = True, wipe: bool = True) -> None:
        """Take a command line: ``--key value ...`` and ``--GROUP::key value ...``.

        Args:
            argv: its words.
            skipFirst: whether the first is the program's name.
            wipe: whether to remove first what there is.
        """
        if wipe:
            self.clear()
        arguments.take(list(argv)[1 if skipFirst else 0 :], self._entries)

    def fromArguments(self, text: str, wipe: bool = True) -> None:
        """Take a command line as one text; double quotes hold words together."""
        self.fromCommand(arguments.split(text), skipFirst=False, wipe=wipe)

    def fromQuery(self, url: str, wipe: bool = True) -> None:
        """Take what a URL says behind its question mark."""
        self._take(arguments.query(url), wipe)

    def fromConfigFile(self, fname: str, env: Searchable | bool | None = None, wipe: bool = True) -> bool:
        """Take a configuration file, or all ``.ini`` files of a folder.

        Args:
            fname: the file; includes are looked for beside it, too.
            env: values for ``$NAMES`` in it that the environment does not have; may be left out: then ``wipe`` is next.
            wipe: whether to remove first what there is.

        Returns:
            False where there is no such file; then nothing is removed.
        """
        values, wipe = (None, env) if isinstance(env, bool) else (env, wipe)
        return config_text.read_file(str(fname), self._entries, values, wipe)

    def fromConfigDir(self, dirname: str, section: str = "", wipe: bool = True) -> bool:
        """Take all ``.ini`` files of a folder; with a section, each as a group whose name is listed there."""
        return config_text.read_folder(str(dirname), section, self._entries, wipe)

    def fromConfig(self, txt: str, env: Searchable | bool | None = None, wipe: bool = True) -> None:
        """Take the text of a configuration file."""
        values, wipe = (None, env) if isinstance(env, bool) else (env, wipe)
        if wipe:
            self.clear()
        config_text.read(txt, self._entries, values)

    # as a message: YARP sends and reads the text form's values, sorted by keys

    def _write(self, out: Writer) -> None:
        for part in encode_parts(from_text(self.toString()), out.profile):
            out.block(part)

    def _read(self, source: Reader) -> None:
        values, end = decode_prefix(source.data, source.profile, source.at)
        self._take(dict_of(from_text(to_text(values))), wipe=True)
        source.at = end

    def to_text(self) -> str:
        """The text form."""
        return self.toString()

    def from_text(self, line: str) -> None:
        """Become what a text says."""
        self.fromString(line)

    # Python's names

    def __getitem__(self, key: str) -> Any:
        return self._entries[key]

    def __setitem__(self, key: str, value: Any) -> None:
        self._entries[key] = plain_of(value)

    def __delitem__(self, key: str) -> None:
        del self._entries[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __bool__(self) -> bool:
        return True

    def keys(self) -> Sequence[str]:
        """The keys."""
        return list(self._entries)

    def items(self) -> Sequence[tuple[str, Any]]:
        """Keys with their plain values."""
        return list(self._entries.items())

    def get(self, key: str, default: Any = None) -> Any:
        """The plain value under a key, or a default."""
        return self._entries.get(key, default)

    def __eq__(self, other: object) -> bool:
        return self.toString() == other.toString() if isinstance(other, Property) else self._entries == other

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Property({self.toString()!r})"

    def _has(self, key: str) -> bool:
        return key in self._entries

    def _take(self, entries: Mapping[str, Any], wipe: bool) -> None:
        if wipe:
            self.clear()
        self._entries.update(entries)

    def _become(self, other: Property) -> None:
        self._take(dict(other._entries), wipe=True)
