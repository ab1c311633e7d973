"""The simulator's environment: DART's Python package (published only for Linux), and the files in this folder."""

from __future__ import annotations

import importlib.util
import platform
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
    """A simulator error; the text names the fact, its place and the cure."""


_PACKAGE = "dartpy"


def has_wheel() -> bool:
    """Return whether dartpy is published for this machine and Python."""
    return sys.platform == "linux" and platform.machine() in ("x86_64", "aarch64") and sys.version_info < (3, 14)


def missing() -> str:
    """Return why dartpy is missing, "" if it is installed; does not import dartpy."""
    if importlib.util.find_spec(_PACKAGE) is not None:
        return ""
    systems = "Linux on x86-64 and arm64 with Python 3.10 to 3.13"
    elsewhere = f"it is published only for {systems}; run 'midspan sim' on such a machine, joined to the same hub"
    cure = "pip install 'midspan[sim]'" if has_wheel() else elsewhere
    return f"the simulator needs dartpy, which is not installed: {cure}"


@cache
def dartpy() -> Any:
    """Import dartpy; raises `SimError` if it is not installed, or cannot be loaded."""
    if problem := missing():
        raise SimError(problem)
    try:
        return importlib.import_module(_PACKAGE)
    except ImportError as err:
        cure = ": apt install libgl1" if "libGL" in str(err) else ""
        raise SimError(f"cannot load dartpy: {err}{cure}") from None


def available(config: Config) -> str:  # noqa: ARG001 - the signature for all workers
    """Return why the worker cannot run on this machine, "" if it can."""
    return missing()


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:  # noqa: ARG001 - as above
    """Return the environment of the worker's process; raises `SimError` if the worker cannot run on this machine."""
    if problem := missing():
        raise SimError(problem)
    return {
        **environ,
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }  # prevents dartpy's wheels from starting Python a second time


Model = TypeVar("Model", bound=BaseModel)

_FOLDER = Path(__file__).parent


def ready(folder: str) -> list[str]:
    """Return the names of the plans (``plans``) or robots (``robots``) that come with Midspan."""
    return sorted(file.stem for file in (_FOLDER / folder).glob("*.yaml"))


def find(folder: str, name: str | Path) -> Path:
    """Return the file of a name that comes with Midspan, or else a path; raises `SimError` if neither exists."""
    shipped = _FOLDER / folder / f"{name}.yaml"
    if name in ready(folder):
        return shipped
    file = Path(name).expanduser()
    if not file.is_file():
        msg = f"'{name}' is neither a file nor one of the {folder} that come with Midspan: {', '.join(ready(folder))}"
        raise SimError(msg)
    return file


def document(file: Path) -> Document:
    """Read a YAML file whose root is a map; raises `SimError` with all problems of the file."""
    try:
        loaded = read(file)
    except ConfigError as err:
        raise SimError(str(err)) from None
    if not isinstance(loaded.data, dict):
        raise SimError(f"{file}: the file must be a map of keys")
    return loaded


def checked(source: Document, model: type[Model], data: dict[str, Any] | None = None) -> Model:
    """Validate a file's data as a model; raises `SimError` with file and line of each error."""
    try:
        return model.model_validate(source.data if data is None else data)
    except ValidationError as err:
        raise SimError(str(ConfigError(problems(source, model, err.errors(include_url=False))))) from None
