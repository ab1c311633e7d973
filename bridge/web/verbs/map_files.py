"""The map files of pages: uploads in parts, imports, downloads as zips, and the renaming of maps.

Files are sent in calls, as base64 in parts, so that exactly the clients that may call verbs may send files.
"""

from __future__ import annotations

import base64
import binascii
import io
import re
import secrets
import tempfile
import threading
import time
import zipfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from bridge.client.store import StoreClient
from bridge.stores.entry import StoreError
from bridge.stores.kinds import CURRENT, MAP
from bridge.stores.service import read_files
from bridge.stores.store import THE_MAP, Write, moved
from bridge.web.verbs.verbs import PageVerb, VerbError, name_of, truth_of
from yarp_compat.dev.mapfile import MapFileError
from yarp_compat.file_names import forbidden

MOST_BYTES = 64 << 20
"""Maximum size of an upload (compressed and decompressed) and of a download, bytes."""

MOST_FILES, MOST_AT_ONCE = 40, 3
MOST_PART = 48_000
"""Maximum number of characters of an uploaded part."""

PART = 384 * 1024
"""Bytes of a downloaded part."""

IDLE_SECONDS = 60.0
_UNPACK_ERRORS = (
    zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, OSError, ValueError,
)  # fmt: skip
_NAME = re.compile(r"[\w\- ().]{1,200}")


class Transfers:
    """Transfers of files by unguessable keys. Safe to use from any thread.

    At most `MOST_AT_ONCE` are stored; a new transfer first removes the transfers that were idle for `IDLE_SECONDS`.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._files: dict[str, tuple[float, dict[str, bytearray]]] = {}

    def new(self, files: dict[str, bytearray]) -> str:
        """Store files, and return their key. Raises `VerbError` if too many are stored."""
        with self._lock:
            now = time.monotonic()
            self._files = {key: entry for key, entry in self._files.items() if now - entry[0] < IDLE_SECONDS}
            if len(self._files) >= MOST_AT_ONCE:
                raise VerbError(f"{MOST_AT_ONCE} transfers are already in progress; try again in {IDLE_SECONDS:g} s")
            key = secrets.token_hex(8)
            self._files[key] = now, files
            return key

    def files(self, key: str) -> dict[str, bytearray]:
        """Return the files of a key; raises `VerbError` if they are no longer stored."""
        with self._lock:
            if key not in self._files:
                raise VerbError("this transfer has expired; start again")
            files = self._files[key][1]
            self._files[key] = time.monotonic(), files
            return files

    def remove(self, key: str) -> None:
        """Remove the files of a key."""
        with self._lock:
            self._files.pop(key, None)

    def add(self, key: str, file: str, at: int, data: bytes) -> int:
        """Append a part to a file, and return the file's length.

        Raises `VerbError` if the part does not follow the previous one, or a limit is exceeded.
        """
        files = self.files(key)
        with self._lock:
            content = files.get(file, bytearray())
            if at != len(content):
                raise VerbError(f"{file}: the part at {at} does not follow the {len(content)} bytes received")
            if len(files.keys() | {file}) > MOST_FILES or sum(map(len, files.values())) + len(data) > MOST_BYTES:
                raise VerbError(f"the limits are {MOST_FILES} files and {MOST_BYTES >> 20} MB in total")
            content += data
            files[file] = content
            return len(content)


def file_of(value: Any) -> str:
    """Check a file's name, without a folder."""
    if not isinstance(value, str) or not _NAME.fullmatch(value) or value.startswith("."):
        raise ValueError("must be a file name of letters, digits, spaces and - _ . ( )")
    if reason := forbidden(value):
        raise ValueError(reason)
    return value


def place_of(value: Any) -> int:
    """Check a position in a file, in bytes."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MOST_BYTES:
        raise ValueError(f"must be an integer up to {MOST_BYTES}")
    return value


def data_of(value: Any) -> bytes:
    """Check a part of a file, and decode it from base64."""
    try:
        if isinstance(value, str) and len(value) <= MOST_PART:
            return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError):
        pass
    raise ValueError(f"must be base64 of up to {MOST_PART} characters")


def unpacked(files: dict[str, bytearray]) -> dict[str, bytes]:
    """Return the files, including those in zips except hidden ones, without their folders.

    Raises `VerbError`, for example if two files of different content have the same name, in two folders.
    """
    unpacked_ = {name: bytes(data) for name, data in files.items() if not name.lower().endswith(".zip")}
    room = MOST_BYTES
    for name, data in files.items():
        if not name.lower().endswith(".zip"):
            continue
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                shown = [info for info in archive.infolist() if not _is_hidden(info)]
                for info in shown[: MOST_FILES + 1]:
                    inner = file_of(Path(info.filename).name)
                    with archive.open(info) as stream:
                        content = stream.read(room + 1)
                    room -= len(content)
                    if unpacked_.setdefault(inner, content) != content:
                        raise VerbError(f"{name} has several files {inner}: import each map separately")
                    if room < 0 or len(unpacked_) > MOST_FILES:
                        raise VerbError(f"{name} has more than {MOST_FILES} files or {MOST_BYTES >> 20} MB")
        except _UNPACK_ERRORS as err:
            if isinstance(err, VerbError):
                raise
            raise VerbError(f"cannot unpack {name}: {err}") from None
    return unpacked_


def _is_hidden(info: zipfile.ZipInfo) -> bool:
    """Return whether an entry is a folder or hidden; macOS adds a hidden file for each file."""
    return info.is_dir() or Path(info.filename).name[:1] in ("", ".")


def root_files(names: Iterable[str]) -> list[str]:
    """Return the files that refer to the others: .ini files except extras, and YARP's maps; if none, ROS maps.

    A collection of maps refers to its maps, so maps are not included if there is a collection.
    """
    by_form: dict[str, list[str]] = {}
    for name in sorted(names):
        by_form.setdefault(Path(name).suffix.lower(), []).append(name)
    lists = [name for name in by_form.get(".ini", []) if not name.endswith("_extras.ini")]
    maps = by_form.get(".map") or [*by_form.get(".yaml", []), *by_form.get(".yml", [])]
    return lists + ([] if any("collection" in name for name in lists) else maps)


class MapFileVerbs:
    """The verbs for map files, which run on threads that may block.

    Args:
        store: returns the store; raises `StoreError` if there is none.
        changed: called after each change.
    """

    def __init__(self, store: Callable[[], StoreClient], changed: Callable[[], None]) -> None:
        self._store, self._changed = store, changed
        self._up, self._down = Transfers(), Transfers()

    def verbs(self) -> dict[str, PageVerb]:
        """Return the verbs by name."""
        key, named = {"key": name_of}, {"name": name_of}
        part = {**key, "file": file_of, "at": place_of, "data": data_of}
        return {
            "rename_map": PageVerb(self._rename, {**named, "to": name_of}, {}),
            "upload": PageVerb(lambda: self._up.new({}), {}, {}),
            "upload_part": PageVerb(self._up.add, part, {}, logged=False),
            "import_map": PageVerb(self._import, key, {**named, "replace": truth_of, "use": truth_of}),
            "export_map": PageVerb(self._export, named, {}, commands=False),
            "download_part": PageVerb(self._part, {**key, "at": place_of}, {}, commands=False),
        }

    def _rename(self, name: str, to: str) -> str:
        self._store().rename(MAP, name, to)
        self._changed()
        return f"renamed {name} to {to}"

    def _import(self, key: str, name: str = "", *, replace: bool = False, use: bool = False) -> dict[str, Any]:
        writes = self._read(key)
        maps = [write for write in writes if write.kind is MAP]
        if name and len(maps) == 1:
            writes = [moved(write, maps[0].name, name) for write in writes]
            maps = [write for write in writes if write.kind is MAP]
        store, taken = self._store(), set[tuple[str, str]]()
        keys = {(write.kind.name, write.name) for write in writes}

        def make_writes() -> list[Write[Any]]:
            nonlocal taken
            taken = set() if replace else keys & store.keys()
            chosen = [Write(CURRENT, THE_MAP, maps[0].name)] if use and maps else []
            return [] if taken else [*writes, *chosen]

        store.change(make_writes)
        if not taken:
            self._up.remove(key)
            self._changed()
        return {
            "done": not taken,
            "maps": [write.name for write in maps],
            "taken": [list(key_) for key_ in sorted(taken)],
        }

    def _read(self, key: str) -> list[Write[Any]]:
        files = unpacked(self._up.files(key))
        first = root_files(files)
        if not first:
            raise VerbError(f"no map among {', '.join(files) or 'no files'}: a .map, .yaml or .ini file is needed")
        with tempfile.TemporaryDirectory(prefix="midspan-map-") as folder:
            for file, data in files.items():
                (Path(folder) / file).write_bytes(data)
            try:
                writes = [write for head in first for write in read_files(Path(folder) / head, Path(folder))]
            except StoreError as err:
                raise VerbError(str(err).replace(f"{folder}/", "")) from None
        names = [(write.kind.name, write.name) for write in writes]
        if len(set(names)) < len(names):
            raise VerbError("two of the files have values of the same name")
        return writes

    def _export(self, name: str) -> dict[str, Any]:
        grid = self._store().get(MAP, name)
        if grid is None:
            raise VerbError(f"no map {name!r} in the store")
        packed = io.BytesIO()
        try:
            with tempfile.TemporaryDirectory(prefix="midspan-map-") as folder:
                grid.save(Path(folder) / f"{name}.map")
                with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as archive:
                    for file in sorted(Path(folder).iterdir()):
                        archive.write(file, f"{name}/{file.name}")
        except (MapFileError, ValueError) as err:
            raise VerbError(str(err)) from None
        data = bytearray(packed.getvalue())
        if len(data) > MOST_BYTES:
            raise VerbError(f"the map has {len(data) >> 20} MB; 'midspan map export' writes it to files")
        return {"key": self._down.new({"": data}), "file": f"{name}.zip", "size": len(data)}

    def _part(self, key: str, at: int) -> str:
        data = self._down.files(key)[""]
        part = bytes(data[at : at + PART])
        if at + PART >= len(data):
            self._down.remove(key)
        return base64.b64encode(part).decode()
