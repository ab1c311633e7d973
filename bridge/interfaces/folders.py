"""Reads definitions from folders of message packages."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bridge.interfaces.definition import Form
from bridge.interfaces.errors import BuildError


def read_package_folder(folder: Path) -> dict[str, str]:
    """All definitions of one package's folder, text by path (``msg/Name.msg``); {} where there are none.

    ``.msg`` files may lie in the folder itself as well.
    """
    files = {f"{form.value}/{file.name}": file for form in Form for file in folder.glob(f"{form.value}/*.{form.value}")}
    files |= {f"msg/{file.name}": file for file in folder.glob("*.msg")}
    return {path: _text(file) for path, file in sorted(files.items())}


def read_folders(folders: Iterable[Path]) -> dict[str, dict[str, str]]:
    """Definitions by package and path; each folder is a package's, or holds packages' folders.

    Raises:
        BuildError: a folder has no definitions, or two have the same package.
    """
    found: dict[str, dict[str, str]] = {}
    for folder in folders:
        whole = folder.resolve()
        candidates = [whole, *sorted(entry for entry in whole.iterdir() if entry.is_dir())] if whole.is_dir() else []
        packages = {entry.name: files for entry in candidates if (files := read_package_folder(entry))}
        if not packages:
            raise BuildError(
                f"no .msg, .srv or .action files in {folder}",
                cure="Name a package's folder (my_msgs with my_msgs/msg/Name.msg), or one that holds such folders",
            )
        for package, files in packages.items():
            if package in found:
                raise BuildError(
                    f"package {package} is there twice", cure=f"Leave out one of the folders named {package}"
                )
            found[package] = files
    return found


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as err:
        raise BuildError(f"cannot be read: {err}", where=str(file)) from None
