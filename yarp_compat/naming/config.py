"""Reads and writes YARP's configuration files with the address of the name server.

``yarp.conf`` in YARP's configuration folder has one line, ``<address> <port> yarp``; the older form ``[name]``,
``host X``, ``port N`` is read too. The name of a network, its namespace, is the port name of its name server. A network
other than ``/root`` has its own file: ``_robot.conf`` for ``/robot``. A program's namespace is set by
``YARP_NAMESPACE`` or ``yarp_namespace.conf``.

The folders are those of YARP 3 and 4 (``yarp/conf/dirs.h`` and ``NameConfig.cpp`` of robotology/yarp).
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from yarp_compat.naming.directories import Directories
from yarp_compat.ports.naming import NamingConfigError
from yarp_compat.wire.contact import PortContact

DEFAULT_NAMESPACE = "/root"
DEFAULT_PORT = 10000
NAMESPACE_FILE = "yarp_namespace.conf"
_MAX_BYTES = 64 * 1024


@dataclass(frozen=True, slots=True)
class Address:
    """The address of a name server; ``mode`` is the kind of server, ``yarp`` except in old files."""

    host: str
    port: int
    mode: str = "yarp"

    def contact(self, namespace: str) -> PortContact:
        """Return the contact of the name server itself."""
        return PortContact(namespace, self.host, self.port)


def folder(environment: Mapping[str, str] | None = None, platform: str = sys.platform) -> str:
    """Return YARP's configuration folder for this user and operating system. An empty variable counts as unset."""
    env = {name: value for name, value in (os.environ if environment is None else environment).items() if value}
    home = "USERPROFILE" if platform == "win32" else "HOME"
    return Directories({home: str(Path.home()), **env} if home not in env else env, platform).config_home()


def namespaces(environment: Mapping[str, str] | None = None) -> list[str]:
    """Return the names of the networks, this program's first: from ``YARP_NAMESPACE``, else the file, else ``/root``.

    Raises `NamingConfigError`.
    """
    env = os.environ if environment is None else environment
    text = env.get("YARP_NAMESPACE") or _read(Path(folder(env)) / NAMESPACE_FILE)
    names = [name.strip('"') for name in re.split(r"[\s,]+", text) if name.strip('"')]
    return names or [DEFAULT_NAMESPACE]


def namespace(environment: Mapping[str, str] | None = None) -> str:
    """Return the name of this program's network, which is the port name of its name server."""
    return namespaces(environment)[0]


def file(name: str | None = None, environment: Mapping[str, str] | None = None) -> Path:
    """Return the file with the address of a network's name server, by default of this program's network."""
    space = namespace(environment) if name is None else name
    base = "yarp" if space == DEFAULT_NAMESPACE else re.sub(r"[^0-9A-Za-z]", "_", space)
    return Path(folder(environment)) / f"{base}.conf"


def read(name: str | None = None, environment: Mapping[str, str] | None = None) -> Address | None:
    """Read the address of a network's name server; None without a file. Raises `NamingConfigError` if it is invalid."""
    path = file(name, environment)
    text = _read(path)
    if not text.strip():
        return None
    try:
        return parse(text)
    except NamingConfigError as err:
        raise NamingConfigError(f"{path}: {err}") from None


def write(address: Address, name: str | None = None, environment: Mapping[str, str] | None = None) -> Path:
    """Write the address of a network's name server atomically; return the written file."""
    path = file(name, environment)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, f"{address.host} {address.port} {address.mode}\n".encode())
    except OSError as err:
        raise NamingConfigError(f"cannot write {path}: {err.strerror or err}") from None
    return path


def parse(text: str) -> Address:
    """Parse either form of the file; raises `NamingConfigError` for any other text."""
    parts = re.split(r'["\s]+', text.strip().strip('"'))
    fields = _old_form(text) if parts[0].startswith("[") else parts
    if len(fields) < 2 or not fields[0]:
        raise NamingConfigError(
            f"expected '<address> <port> yarp', for example '127.0.0.1 10000 yarp', not {text.strip()[:80]!r}"
        )
    if not fields[1].isdecimal() or len(fields[1]) > 5 or not 0 < int(fields[1]) <= 0xFFFF:
        raise NamingConfigError(f"the port must be a number from 1 to 65535, not {fields[1][:80]!r}")
    return Address(fields[0], int(fields[1]), fields[2] if len(fields) > 2 else "yarp")


def _old_form(text: str) -> list[str]:
    values: dict[str, str] = {}
    section = ""
    for line in text.splitlines():
        parts = line.split("//")[0].replace('"', " ").split()
        if parts and parts[0].startswith("["):
            section = parts[0].strip("[]")
        elif len(parts) >= 2 and section == "name":
            values[parts[0]] = parts[1]
    if "host" not in values or "port" not in values:
        return []
    return [values["host"], values["port"], values.get("mode", "yarp")]


def _read(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
    except (FileNotFoundError, NotADirectoryError):
        return ""
    except OSError as err:
        raise NamingConfigError(f"cannot read {path}: {err.strerror or err}") from None
    if len(data) > _MAX_BYTES:
        raise NamingConfigError(f"{path} is larger than {_MAX_BYTES} bytes: YARP did not write it")
    return data.decode("utf-8", "replace")


def replace_file(path: Path, data: bytes) -> None:
    """Write a file atomically: a crash leaves the old or the new content; raises `OSError`."""
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        Path(temporary).chmod(0o644)  # readable by others, like YARP's own files
        Path(temporary).replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            Path(temporary).unlink()
        raise
