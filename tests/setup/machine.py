"""A fake machine for `scripts/setup.sh`, whose commands are small scripts that log their calls."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_TOOLS = (
    "cat", "chmod", "cut", "date", "dirname", "env", "grep", "ln", "mkdir", "mv", "rm",
    "sed", "sh", "sha256sum", "tail", "touch", "tr",
)  # fmt: skip

_PYTHON = """#!/bin/sh
echo "python $*" >>"$LOG"
case "$*" in
    *"-m venv"*)
        mkdir -p .venv/bin
        cat "$0" >.venv/bin/python
        chmod +x .venv/bin/python
        ;;
    *"pip install"*requirements-ros2.lock*) [ -z "${NO_WHEELS:-}" ] ;;
    *"pip install"*requirements-kilted.lock*)
        [ -z "${NO_WHEELS:-}" ] || exit 1
        folder=${*#*--prefix }
        mkdir -p "${folder%% *}/lib"
        ;;
    *"--editable ."*)
        printf '#!/bin/sh\\necho "midspan $*" >>"$LOG"\\n' >.venv/bin/midspan
        chmod +x .venv/bin/midspan
        ;;
    *"import rclpy"*) [ -z "${NO_WHEELS:-}" ] ;;
    *bridge/kernels.py) [ -f .venv/kernels ] || { echo "2 of 3 kernels are not compiled"; exit 1; } ;;
    *build_ext*) [ -n "${NO_COMPILER:-}" ] || touch .venv/kernels ;;
esac
"""
_DPKG_QUERY = """#!/bin/sh
shift 2
for package in "$@"; do
    case " $NOT_INSTALLED " in
        *" $package "*) ;;
        *) echo "installed:$package" ;;
    esac
done
"""
_APT_CACHE = """#!/bin/sh
case " $NOT_IN_ARCHIVE " in *" $2 "*) exit 100 ;; esac
case " $ONLY_NAMED " in *" $2 "*) exit ;; esac
echo "Package: $2"
"""
_APT_GET = """#!/bin/sh
echo "apt-get $*" >>"$LOG"
case "$*" in *" download "*) for package; do :; done; touch "${package}_1_amd64.deb" ;; esac
"""
_DPKG_DEB = """#!/bin/sh
echo "dpkg-deb $*" >>"$LOG"
mkdir -p "$3/usr/bin" "$3/usr/sbin"
touch "$3/usr/bin/promtool" "$3/usr/sbin/nginx"
chmod +x "$3/usr/bin/promtool" "$3/usr/sbin/nginx"
"""


class Machine:
    """A checkout on a fake machine.

    Args:
        folder: where it is created.
        apt: whether the machine has apt.
        user: the user ID; 0 is root.
        sudo: whether the user may become root.
    """

    def __init__(self, folder: Path, *, apt: bool = True, user: int = 0, sudo: bool = False) -> None:
        self.checkout = folder / "checkout"
        self._bin = folder / "bin"
        self._log = folder / "log"
        (self.checkout / "scripts").mkdir(parents=True)
        self._bin.mkdir()
        locks = ("requirements.lock", "requirements-ros2.lock", "requirements-kilted.lock")
        for file in ("scripts/setup.sh", "pyproject.toml", "setup.py", *locks):
            shutil.copy(ROOT / file, self.checkout / file)
        for tool in _TOOLS:
            (self._bin / tool).symlink_to(shutil.which(tool) or tool)
        self._command("python3", _PYTHON)
        self._command("id", f"#!/bin/sh\necho {user}\n")
        if apt:
            self._command("dpkg-query", _DPKG_QUERY)
            self._command("apt-cache", _APT_CACHE)
            self._command("apt-get", _APT_GET)
            self._command("dpkg-deb", _DPKG_DEB)
        if sudo:
            self._command("sudo", '#!/bin/sh\necho "sudo $*" >>"$LOG"\n[ "$1" = -n ] && shift\nexec "$@"\n')

    def _command(self, name: str, text: str) -> None:
        (self._bin / name).write_text(text, encoding="utf-8")
        (self._bin / name).chmod(0o755)

    def setup(self, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run the set-up script, whose calls are then in `calls`."""
        self._log.write_text("", encoding="utf-8")
        env = {
            "PATH": str(self._bin),
            "LOG": str(self._log),
            "PYTHON": "python3",
            "HOME": str(self.checkout),
            **variables,
        }
        script = self.checkout / "scripts" / "setup.sh"
        return subprocess.run(
            ["/bin/sh", script],
            env=env,
            capture_output=True,
            text=True,
            check=False,
            stdin=subprocess.DEVNULL,
            timeout=100,
        )

    @property
    def calls(self) -> list[str]:
        """The calls of the last run, without those that only query Python."""
        lines = self._log.read_text(encoding="utf-8").splitlines()
        questions = ("python -c", "python -V", "python -P bridge/kernels.py")
        return [line for line in lines if not line.startswith(questions)]

    def called(self, *parts: str) -> list[str]:
        """Return the calls that contain all these words."""
        return [line for line in self.calls if all(part in line for part in parts)]
