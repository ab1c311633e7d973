"""The definitions of standard types that rosbags ships, read without the message classes in the same files.

A store of rosbags is a generated Python module: a dataclass for each type, and the table ``FIELDDEFS``. Each release
takes most of its table from the previous one. Creating 300 dataclasses takes most of a module's import time, and
workers use only the tables, so this module runs the stores' code with a decorator that leaves the classes as they are.
"""

from __future__ import annotations

import builtins
from collections.abc import Mapping
from importlib.machinery import SourceFileLoader
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

_FOLDER = Path("typesys", "stores")


def read_store(store: str) -> Mapping[str, Any]:
    """Return a store's table of constants and fields by type, e.g. of ``ros2_jazzy``."""
    package = find_spec("rosbags")
    assert package is not None
    assert package.submodule_search_locations is not None
    folder = Path(package.submodule_search_locations[0]) / _FOLDER
    table: Mapping[str, Any] = _run(folder, store)["FIELDDEFS"]
    return table


def _run(folder: Path, store: str) -> dict[str, Any]:
    name = f"rosbags.typesys.stores.{store}"
    code = SourceFileLoader(name, str(folder / f"{store}.py")).get_code(name)
    assert code is not None

    def import_(module: str, scope: Any = None, names: Any = None, wanted: Any = (), level: int = 0) -> Any:
        if level:  # a relative import from another store
            return SimpleNamespace(**{other: SimpleNamespace(**_run(folder, other)) for other in wanted})
        if module == "dataclasses":
            return SimpleNamespace(dataclass=lambda cls: cls)
        return __import__(module, scope, names, wanted)

    scope = {"__name__": name, "__builtins__": {**vars(builtins), "__import__": import_}}
    exec(code, scope)  # noqa: S102 - the code of a module that would be imported otherwise
    return scope
