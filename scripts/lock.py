"""Writes the lock files: the exact versions that `make` installs. Run it in the virtual environment, with Python 3.11.

requirements.lock has what Midspan and its tests need, requirements-ros2.lock the ROS 2 wheels besides (not installed
where a ROS 2 installation is sourced). What the oldest supported Python takes, the newer ones take as well; the
continuous integration shows it. The files name versions only: pip finds them at whatever index it is set up for.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
HEAD = "# Written by scripts/lock.py (`make lock`). Do not edit.\n"


def resolve(requirements: list[str]) -> dict[str, str]:
    """Let pip choose versions for all requirements and what they need: version by name."""
    with tempfile.NamedTemporaryFile(suffix=".json") as report:
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
        subprocess.run([*command, "--report", report.name, *requirements], check=True)
        found: dict[str, Any] = json.load(report)
    return {entry["metadata"]["name"]: entry["metadata"]["version"] for entry in found["install"]}


def write(file: str, versions: dict[str, str]) -> None:
    """Write one lock file, sorted by name."""
    lines = [f"{name}=={version}\n" for name, version in sorted(versions.items(), key=lambda item: item[0].lower())]
    (ROOT / file).write_text(HEAD + "".join(lines), encoding="utf-8")


def main() -> None:
    """Resolve everything at once, then find out which part needs no ROS 2 wheels."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    base = [*project["dependencies"], *extras["dev"]]
    whole = resolve([*base, *extras["ros2"]])
    plain = resolve([*base, *(f"{name}=={whole[name]}" for name in resolve(base) if name in whole)])
    write("requirements.lock", plain)
    write("requirements-ros2.lock", {name: version for name, version in whole.items() if name not in plain})


if __name__ == "__main__":
    main()
