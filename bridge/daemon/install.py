"""The files of the systemd services, their places and their contents."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

from bridge.config import generate
from bridge.shipped import shipped_folder

UNITS = ("midspan-router.service", "midspan.service", "midspan-router@.service", "midspan@.service")
UNIT_FOLDER = Path("etc/systemd/system")
OWN_USER = "midspan"


@dataclass(frozen=True, slots=True)
class InstalledFile:
    """One file below the root; a ``kept`` file belongs to the administrator, and is never overwritten or removed."""

    path: Path
    text: str
    kept: bool = False
    mode: int = 0o644


class Installation:
    """The services below a root folder; with ``dry_run`` it only reports what it would do."""

    def __init__(self, root: Path, user: str = OWN_USER, *, dry_run: bool = False) -> None:
        self._root = root.absolute()
        self._user = user
        self._dry_run = dry_run

    def files(self) -> list[InstalledFile]:
        """Return the files to install: units, Midspan's own user if it is used, and the initial configuration."""
        files = [InstalledFile(UNIT_FOLDER / name, self._unit(name)) for name in UNITS]
        if self._user == OWN_USER:
            files.append(InstalledFile(Path("etc/sysusers.d/midspan.conf"), _template("packaging/midspan.sysusers")))
        settings = Path("etc/midspan")
        return [
            *files,
            InstalledFile(settings / generate.SCHEMA_FILE, generate.schema()),
            InstalledFile(settings / "midspan.yaml", _template("configs/default.yaml"), kept=True),
            InstalledFile(settings / "environment", _template("packaging/environment"), kept=True, mode=0o640),
        ]

    def _unit(self, name: str) -> str:
        text = _template(f"packaging/{name}").replace("@MIDSPAN@", midspan_command())
        return text.replace(f"\nUser={OWN_USER}\n", f"\nUser={self._user}\n")

    def install(self) -> list[str]:
        """Write the files that are missing or differ; return what was done and what to do next, as lines."""
        lines = [self._write(file) for file in self.files()]
        lines += ["", *self._warnings(), "Next:"]
        if self._user == OWN_USER:
            lines.append("  systemd-sysusers                         # creates the user midspan")
        return [
            *lines,
            "  midspan config check /etc/midspan/midspan.yaml",
            "  systemctl daemon-reload",
            "  systemctl enable --now midspan-router midspan",
            "  systemctl status midspan                 # and after changes: systemctl reload midspan",
            "For another daemon (second robot or ROS domain), write /etc/midspan/NAME.yaml with its own 'name', then:",
            "  systemctl enable --now midspan-router@NAME midspan@NAME",
        ]

    def _write(self, file: InstalledFile) -> str:
        path = self._root / file.path
        if path.exists() and file.kept:
            return f"kept       {path}"
        old = path.read_text(encoding="utf-8") if path.exists() else None
        if old == file.text:
            return f"unchanged  {path}"
        if not self._dry_run:
            path.parent.mkdir(parents=True, exist_ok=True)
            new = path.with_name(path.name + ".new")
            new.write_text(file.text, encoding="utf-8")
            new.chmod(file.mode)
            new.replace(path)
        action = "written" if old is None else "replaced"
        return f"{'would be ' if self._dry_run else ''}{action:9}  {path}"

    def _warnings(self) -> list[str]:
        folder = _closed_folder(Path(sys.executable).absolute().parent)
        if folder is None:
            return []
        return [
            f"Warning: the services' user cannot enter {folder}, and Midspan is installed below it.",
            "Install it where all users may read, for example in /opt/midspan, or give '--user' a user who may.",
            "",
        ]

    def uninstall(self) -> list[str]:
        """Remove the files that `install` wrote, except files that the administrator edits."""
        lines = []
        for file in self.files():
            path = self._root / file.path
            if not path.exists():
                continue
            if file.kept:
                lines.append(f"kept       {path}")
                continue
            if not self._dry_run:
                path.unlink()
            lines.append(f"{'would be ' if self._dry_run else ''}removed    {path}")
        if not lines:
            return [f"Midspan's services are not installed below {self._root}"]
        return [
            *lines,
            "",
            "Next:",
            f"  systemctl disable --now {' '.join(['midspan', 'midspan-router', *self._instances()])}",
            "  systemctl daemon-reload",
            "  rm -r /etc/midspan /var/lib/midspan /var/cache/midspan /var/log/midspan   # deletes all data",
        ]

    def _instances(self) -> list[str]:
        """Return the enabled instances of the template units, daemons before their routers."""
        links = (self._root / UNIT_FOLDER).glob("*.wants/midspan*@*.service")
        return sorted({link.stem for link in links}, reverse=True)


def midspan_command() -> str:
    """Return the command of a unit's ExecStart: the script next to this Python, else this Python itself."""
    script = Path(sys.executable).absolute().with_name("midspan")
    if script.exists():
        return _quoted(str(script))
    return " ".join(_quoted(part) for part in (str(Path(sys.executable).absolute()), "-P", "-m", "bridge.cli.main"))


def _quoted(word: str) -> str:
    """Quote a word of ExecStart: systemd reads quotes as a shell does, and expands % and $."""
    return shlex.quote(word.replace("%", "%%").replace("$", "$$"))


def _closed_folder(folder: Path) -> Path | None:
    """Return the outermost parent folder that other users cannot enter, or None."""
    for part in reversed([folder, *folder.parents]):
        if not part.stat().st_mode & 0o001:
            return part
    return None


def _template(name: str) -> str:
    """Return the text of a file that comes with Midspan."""
    return (shipped_folder() / name).read_text(encoding="utf-8")
