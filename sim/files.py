"""Reads the simulator's own YAML files, and finds the ones that come with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from bridge.config import hints
from bridge.config.document import Document, read
from bridge.config.problems import ConfigError
from sim.errors import SimError

Model = TypeVar("Model", bound=BaseModel)

_OWN = Path(__file__).parent


def ready(folder: str) -> list[str]:
    """Names of the files of a kind that come with Midspan (``plans``, ``robots``)."""
    return sorted(file.stem for file in (_OWN / folder).glob("*.yaml"))


def find(folder: str, name: str) -> Path:
    """The file of that name that comes with Midspan, or else the path itself.

    Raises:
        SimError: there is neither.
    """
    own = _OWN / folder / f"{name}.yaml"
    if name in ready(folder):
        return own
    file = Path(name).expanduser()
    if not file.is_file():
        msg = f"{name!r} is neither a file nor one of the {folder} that come with Midspan: {', '.join(ready(folder))}"
        raise SimError(msg)
    return file


def document(file: Path) -> Document:
    """A YAML file that is a map.

    Raises:
        SimError: with all problems of the file.
    """
    try:
        found = read(file)
    except ConfigError as err:
        raise SimError(str(err)) from None
    if not isinstance(found.data, dict):
        msg = f"{file}: must be a map of keys"
        raise SimError(msg)
    return found


def checked(found: Document, model: type[Model], data: dict[str, Any] | None = None) -> Model:
    """The file's data as a model.

    Raises:
        SimError: with the file and line of everything that is wrong.
    """
    try:
        return model.model_validate(found.data if data is None else data)
    except ValidationError as err:
        raise SimError(str(ConfigError(hints.problems(found, model, err.errors(include_url=False))))) from None
