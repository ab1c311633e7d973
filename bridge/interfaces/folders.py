"""Folders of message packages: the user's, and those that come with Midspan (bundled packages)."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path

from bridge.interfaces.definition import BuildError, Form
from bridge.messages.definitions.names import package_name


def read_package_folder(folder: Path) -> dict[str, str]:
    """Return a package's definitions, texts by path (``msg/Name.msg``); ``.msg`` files may be in the folder itself."""
    files = {f"{form.value}/{file.name}": file for form in Form for file in folder.glob(f"{form.value}/*.{form.value}")}
    files |= {f"msg/{file.name}": file for file in folder.glob("*.msg")}
    return {path: _text(file) for path, file in sorted(files.items())}


def read_folders(folders: Iterable[Path]) -> dict[str, dict[str, str]]:
    """Return definitions by package and path.

    Each folder is a package, a package's ``msg``, ``srv`` or ``action``, or contains packages. Raises `BuildError` for
    a folder without definitions, and for two packages with the same name.
    """
    definitions: dict[str, dict[str, str]] = {}
    for folder in folders:
        packages = {}
        for entry in _package_folders(folder.resolve()):
            if files := read_package_folder(entry):
                packages[package_name(entry)] = files
        if not packages:
            raise BuildError(
                f"no .msg, .srv or .action files in {folder}",
                cure="Name a package's folder (my_msgs with my_msgs/msg/Name.msg), or a folder of such folders",
            )
        for package, files in packages.items():
            if package in definitions:
                raise BuildError(f"package {package} is given twice", cure="Leave out one of these folders")
            definitions[package] = files
    return definitions


def _package_folders(folder: Path) -> list[Path]:
    """Return the folders that may be packages: one package's folder, or a folder and its subfolders."""
    if not folder.is_dir():
        return []
    kinds = {form.value for form in Form}
    if folder.name in kinds and any(folder.glob(f"*.{folder.name}")):
        return [folder.parent]
    inner = sorted(entry for entry in folder.iterdir() if entry.is_dir())
    is_named = (folder / "package.xml").is_file() and any(folder.glob("*.msg"))
    if is_named or any(entry.name in kinds and any(entry.glob(f"*.{entry.name}")) for entry in inner):
        return [folder]
    return [folder, *inner]


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as err:
        raise BuildError(f"cannot be read: {err}", where=str(file)) from None


DEFINITIONS = Path(__file__).parent / "definitions"
"""Folder of the bundled packages; its README names the sources of the definitions."""


@cache
def bundled_packages() -> tuple[str, ...]:
    """Return the names of the packages whose definitions come with Midspan."""
    return tuple(sorted(entry.name for entry in DEFINITIONS.iterdir() if entry.is_dir()))


def bundled_files(package: str) -> dict[str, str]:
    """Return a bundled package's definitions by path, for `bridge.interfaces.builder.build`; {} for other packages."""
    return read_package_folder(DEFINITIONS / package) if package in bundled_packages() else {}
