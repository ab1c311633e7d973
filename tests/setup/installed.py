"""Virtual environments with installed wheels, outside the checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Self

from packaging.requirements import Requirement

HERE = Path(sysconfig.get_path("purelib"))
"""The folder of the libraries that are installed for the tests."""


def entries(requirements: Sequence[str]) -> set[str]:
    """Return the names in `HERE` of the packages that requirements demand, directly or indirectly, except Midspan's."""
    waiting, seen, names = list(requirements), set[str](), set[str]()
    while waiting:
        requirement = waiting.pop()
        if requirement in seen:
            continue
        seen.add(requirement)
        wanted = Requirement(requirement)
        package = metadata.distribution(wanted.name)
        if wanted.name != "midspan":
            names |= {file.parts[0] for file in package.files or ()}
        for needed in package.requires or ():
            marker = Requirement(needed).marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *wanted.extras)):
                waiting.append(needed)
    return {name for name in names if (HERE / name).exists()} - {"..", "__pycache__"}


class Installed:
    """A virtual environment with wheels, which uses the tests' libraries.

    Args:
        folder: the folder to create.
        wheels: the wheels to install, without their requirements.
        libraries: requirements that choose which of the tests' packages are available; None: all. Midspan's packages
            come only from the wheels.
    """

    def __init__(self, folder: Path, wheels: Sequence[Path], libraries: Sequence[str] | None = None) -> None:
        self.folder, self.bin = folder, folder / "bin"
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
        site = folder / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
        if libraries is None:
            (site / "libraries.pth").write_text(f"{HERE}\n", encoding="utf-8")
        for name in entries(libraries or ()):
            (site / name).symlink_to(HERE / name)
        if wheels:
            self.pip("install", "-q", "--no-index", "--no-deps", "--no-compile", *map(str, wheels))

    def copy(self, folder: Path) -> Self:
        """Return a copy in another folder. Its programs, except Python, are those of this environment."""
        copy = type(self).__new__(type(self))
        copy.folder, copy.bin = shutil.copytree(self.folder, folder, symlinks=True), folder / "bin"
        return copy

    def environ(self) -> dict[str, str]:
        """The environment of its programs, without references to the checkout."""
        kept = {k: v for k, v in os.environ.items() if k in ("LANG", "LC_ALL", "MIDSPAN_TEST_RUN", "TMPDIR")}
        return {**kept, "PATH": f"{self.bin}:/usr/bin:/bin", "HOME": str(self.folder)}

    def pip(self, *words: str) -> None:
        """Run the tests' pip on the environment."""
        command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", str(self.bin / "python")]
        done = subprocess.run([*command, *words], capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stdout + done.stderr

    def run(self, *words: str | Path, code: int = 0) -> str:
        """Run one of the environment's programs in the environment's folder, and return the output."""
        done = subprocess.run(
            [self.bin / words[0], *words[1:]],
            cwd=self.folder, env=self.environ(), capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout
