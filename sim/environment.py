"""What the simulator needs of this machine: DART's package, which is published for Linux alone."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from bridge.config.document import ConfigError, Document, read
from bridge.config.model import Config
from bridge.config.problems import problems


class SimError(RuntimeError):
    """The simulator cannot do it; the text says what, where and how to mend it."""


_PACKAGE = "dartpy"


def missing() -> str:
    """Say why there is no dartpy, "" where there is; nothing is imported for that."""
    if importlib.util.find_spec(_PACKAGE) is not None:
        return ""
    published = sys.platform == "linux" and sys.version_info < (3, 14)
    cure = "pip install dartpy" if published else "it is published for Linux with Python 3.10 to 3.13 alone"
    return f"the simulator needs dartpy, which is not installed: {cure}"


@cache
def dartpy() -> Any:
    """The package; raises `SimError` if it is not installed here, or cannot be loaded."""
    if why := missing():
        raise SimError(why)
    try:
        return importlib.import_module(_PACKAGE)
    except ImportError as err:
        cure = ": apt install libgl1" if "libGL" in str(err) else ""
        raise SimError(f"dartpy cannot be loaded: {err}{cure}") from None


def available(config: Config) -> str:  # noqa: ARG001 - as all workers are asked
    """Say why the worker cannot run here, "" where it can."""
    return missing()


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:  # noqa: ARG001 - as above
    """The environment of the worker's process; raises `SimError` if it cannot run here."""
    if why := missing():
        raise SimError(why)
    return {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # spares the wheels' second start of Python


Model = TypeVar("Model", bound=BaseModel)

_OWN = Path(__file__).parent


def ready(folder: str) -> list[str]:
    """Names of the files of a kind that come with Midspan (``plans``, ``robots``)."""
    return sorted(file.stem for file in (_OWN / folder).glob("*.yaml"))


def find(folder: str, name: str) -> Path:
    """The file of that name that comes with Midspan, or else the path itself; raises `SimError` if there is neither."""
    own = _OWN / folder / f"{name}.yaml"
    if name in ready(folder):
        return own
    file = Path(name).expanduser()
    if not file.is_file():
        msg = f"{name!r} is neither a file nor one of the {folder} that come with Midspan: {', '.join(ready(folder))}"
        raise SimError(msg)
    return file


def document(file: Path) -> Document:
    """A YAML file that is a map; raises `SimError` with all problems of the file."""
    try:
        found = read(file)
    except ConfigError as err:
        raise SimError(str(err)) from None
    if not isinstance(found.data, dict):
        raise SimError(f"{file}: must be a map of keys")
    return found


def checked(found: Document, model: type[Model], data: dict[str, Any] | None = None) -> Model:
    """The file's data as a model; raises `SimError` with the file and line of everything that is wrong."""
    try:
        return model.model_validate(found.data if data is None else data)
    except ValidationError as err:
        raise SimError(str(ConfigError(problems(found, model, err.errors(include_url=False))))) from None
