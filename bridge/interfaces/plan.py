"""What has to be built, in which order, and under which key: from definitions and what is installed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bridge.interfaces.definition import Definition, Form, Reference, read_package
from bridge.interfaces.errors import BuildError
from bridge.interfaces.ros2 import Ros2
from bridge.interfaces.standing import standing_files
from bridge.interfaces.store import Store, digest

RECIPE = "1"
"""Raise it when what the builder makes of the same definitions changes."""


@dataclass(frozen=True, slots=True)
class Step:
    """One package to build.

    Attributes:
        package: its name.
        definitions: what it defines.
        needs: all built packages that it needs, also indirectly, as steps.
        prefix: where it is, or will be.
    """

    package: str
    definitions: tuple[Definition, ...]
    needs: tuple[Step, ...]
    prefix: Path


class Planner:
    """Resolves packages: what is given first, then what is installed, then Midspan's own definitions.

    Args:
        given: definitions by package and path.
        ros2: the installation.
        store: where built packages are.
    """

    def __init__(self, given: Mapping[str, Mapping[str, str]], ros2: Ros2, store: Store) -> None:
        self._given = given
        self._ros2 = ros2
        self._store = store
        self._steps: dict[str, Step | None] = {}
        self._definitions: dict[str, tuple[Definition, ...]] = {}

    def steps(self) -> list[Step]:
        """The steps for all given packages and what they need, each after those it needs."""
        for package in self._given:
            self._step(package, ())
        return [step for step in self._steps.values() if step is not None]

    def _step(self, package: str, asking: tuple[str, ...]) -> Step | None:
        """The step that builds a package; None where the installed one serves."""
        if package in asking:
            circle = " -> ".join((*asking[asking.index(package) :], package))
            raise BuildError(f"packages need each other in a circle: {circle}", cure="Move the shared types to a third")
        if package not in self._steps:
            self._steps[package] = None if self._is_installed(package) else self._new_step(package, asking)
        return self._steps[package]

    def _is_installed(self, package: str) -> bool:
        installed = self._ros2.packages.get(package)
        if installed is None:
            return False
        missing = [path for path in self._given.get(package, {}) if not installed.has(path)]
        if missing:
            raise BuildError(
                f"package {package} {installed.version} of {installed.prefix} has no {missing[0]},"
                " and an installed package cannot be extended",
                cure="Put the definition into a package of another name, and map the type to it",
            )
        return True

    def _new_step(self, package: str, asking: tuple[str, ...]) -> Step:
        definitions = self._read(package)
        needed: dict[str, Step] = {}
        installed: list[str] = []
        for name in sorted(frozenset().union(*(definition.needs for definition in definitions))):
            if not self._exists(name):
                raise _unknown_package(name, definitions)
            step = self._step(name, (*asking, package))
            if step is None:
                installed.append(f"{name} {self._ros2.packages[name].version}")
            else:
                needed |= {inner.package: inner for inner in (*step.needs, step)}
        self._check_references(definitions)
        texts = [text for definition in definitions for text in (definition.path, definition.text)]
        key = digest(
            [RECIPE, self._ros2.identity, package, *texts, *installed, *(s.prefix.name for s in needed.values())]
        )
        return Step(package, definitions, tuple(needed.values()), self._store.package(package, key))

    def _exists(self, package: str) -> bool:
        return package in self._given or package in self._ros2.packages or bool(standing_files(package))

    def _read(self, package: str) -> tuple[Definition, ...]:
        if package not in self._definitions:
            # a given package with the name of one of ours adds to it, so that both stay usable
            self._definitions[package] = read_package(
                package, standing_files(package) | dict(self._given.get(package, {}))
            )
        return self._definitions[package]

    def _check_references(self, definitions: tuple[Definition, ...]) -> None:
        for definition in definitions:
            for reference in definition.references:
                if not self._has(reference):
                    raise _unknown_type(definition, reference)

    def _has(self, reference: Reference) -> bool:
        path = f"{Form.MSG.value}/{reference.name}.{Form.MSG.value}"
        installed = self._ros2.packages.get(reference.package)
        if installed is not None:
            return installed.has(path)
        return any(definition.path == path for definition in self._read(reference.package))


def _unknown_package(name: str, definitions: tuple[Definition, ...]) -> BuildError:
    for definition in definitions:
        for reference in definition.references:
            if reference.package == name:
                return BuildError(
                    f"package {name} is not known",
                    where=definition.where(reference.line),
                    cure=f"Install it, or put {name}/msg/*.msg into a folder that `types.folders` names",
                )
    return BuildError(f"ROS 2's package {name} is not installed", cure="Run `make` again")


def _unknown_type(definition: Definition, reference: Reference) -> BuildError:
    cure = "ROS 2 calls it std_msgs/Header" if reference.name == "Header" else "Look for a slip in the name"
    return BuildError(
        f"unknown type {reference.package}/{reference.name}", where=definition.where(reference.line), cure=cure
    )
