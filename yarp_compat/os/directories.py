"""YARP's functions for directories and environment variables (`yarp/conf/dirs.h`, `environment.h`)."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from yarp_compat.naming.directories import Directories

path_separator = ";" if sys.platform == "win32" else ":"
"""The separator of directories in an environment variable."""

_DIRECTORIES = Directories()

home = _DIRECTORIES.home
tempdir = _DIRECTORIES.temporary
datahome, datadirs = _DIRECTORIES.data, _DIRECTORIES.shared_data
confighome, configdirs = _DIRECTORIES.config, _DIRECTORIES.shared_config
cachehome, runtimedir = _DIRECTORIES.cache, _DIRECTORIES.runtime
yarpdatahome, yarpdatadirs = _DIRECTORIES.data_home, _DIRECTORIES.data_dirs
yarpconfighome, yarpconfigdirs = _DIRECTORIES.config_home, _DIRECTORIES.config_dirs
yarpcachehome, yarpruntimedir = _DIRECTORIES.cache_home, _DIRECTORIES.runtime_home


def get_string(key: str, default: str = "", *rest: str) -> str:
    """Return an environment variable, or a default.

    Of more than two texts, the second names another variable, the third is its default, the fourth a suffix for both.
    """
    if not rest or key in os.environ:
        return os.environ.get(key, "" if rest else default)
    return os.environ.get(default, rest[0]) + "".join(rest[1:])


def get_path(key: str, default: str = "", *rest: str) -> tuple[str, ...]:
    """Return the directories in an environment variable; for the arguments, see `get_string`."""
    value = get_string(key, default, *rest[:1])
    suffix = "" if key in os.environ else "".join(rest[1:])
    return tuple(path + suffix for path in value.split(path_separator) if path)


def get_bool(key: str, default: bool = False) -> bool:
    """Return whether an environment variable is ``1``, ``true``, ``on`` or ``yes``; the default if empty or unset."""
    return os.environ[key].lower() in ("1", "true", "on", "yes") if os.environ.get(key) else default


def set_string(key: str, value: str) -> bool:
    """Set an environment variable."""
    os.environ[key] = value
    return True


def set_path(key: str, value: Sequence[str]) -> bool:
    """Set an environment variable to a list of directories."""
    return set_string(key, path_separator.join(value))


def set_bool(key: str, value: bool) -> bool:
    """Set an environment variable to ``1`` or ``0``."""
    return set_string(key, "1" if value else "0")


def is_set(key: str) -> bool:
    """Return whether an environment variable is set."""
    return key in os.environ


def unset(key: str) -> bool:
    """Remove an environment variable."""
    os.environ.pop(key, None)
    return True


# names of YARP 3
getEnvironment = get_string
setEnvironment = set_string
unsetEnvironment = unset
