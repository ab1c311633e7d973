"""``midspan keys``: the certificates by which machines identify each other."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.cli.arguments import add_verb, add_verbs
from bridge.cli.output import CliError

if TYPE_CHECKING:
    from bridge.hub.security.certificates import Certificate


MAX_DAYS = 3650

_EPILOG = """\
example, for a robot and an operator's computer:
  midspan keys make robot1 192.168.1.20
  midspan keys make operator1
  midspan keys show

The first 'make' creates the authority that signs all other certificates. Its key, ca.key, stays in this folder only:
anyone who has it can make certificates of any name. Copy ca.pem and the machine's own two files to each machine. A
machine with an ADDRESS listens, a machine without one connects; 'make' prints the configuration for each.
"""


def register(parser: argparse.ArgumentParser) -> None:
    actions = add_verbs(
        parser,
        "Makes or shows the certificates by which the machines of a fleet identify each other over TLS (hub.open).",
        dest="action",
    )
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    make = add_verb(
        actions,
        "make",
        run,
        "make a machine's key and certificate; the first call also makes the authority's",
        hub=False,
    )
    make.add_argument("name", metavar="NAME", help="the machine's name, as 'name' in its configuration")
    make.add_argument(
        "addresses", metavar="ADDRESS", nargs="*", help="names and addresses in addition to NAME, NAME.local"
    )
    make.add_argument(
        "--days", type=_days, default=730, metavar="N", help=f"days until expiry (default 730, at most {MAX_DAYS})"
    )
    make.add_argument("--replace", action="store_true", help="replace the certificate if it exists")
    show = add_verb(
        actions, "show", run, "show certificates: names, and when they expire",
        "Shows certificates: their machines, names and addresses, and when they expire. Exit code 1 if one has"
        " expired, or is not valid yet.", hub=False,
    )  # fmt: skip
    show.add_argument("files", type=Path, nargs="*", metavar="FILE", help="certificates, or folders (default: DIR)")
    show.add_argument("--json", action="store_true", help="print JSON")
    for action in (make, show):
        action.add_argument("--folder", type=Path, metavar="DIR", help="keys' folder (default: ~/.config/midspan/keys)")


def run(args: argparse.Namespace) -> int:
    from bridge.hub.security.certificates import CertificateError

    folder = (args.folder or _default_folder()).expanduser().absolute()
    try:
        if args.action == "show":
            return _show(args.files or [folder], as_json=args.json)
        _make(folder, args)
    except CertificateError as err:
        raise CliError(str(err)) from None
    return 0


def _make(folder: Path, args: argparse.Namespace) -> None:
    from bridge.hub.security.certificates import Authority, general_names

    general_names(args.name, args.addresses)  # first, so that a mistake does not create the authority
    authority = Authority(folder)
    if not authority.exists():
        certificate = authority.make()
        print(f"made the authority: {certificate.file}, valid until {certificate.until:%Y-%m-%d}")
        print(f"  keep {folder}/ca.key here and safe, and never copy it: it makes certificates of any name\n")
    certificate = authority.issue(args.name, args.addresses, args.days, replace=args.replace)
    print(f"made {args.name}.pem and {args.name}.key in {folder}")
    print(f"  valid until {certificate.until:%Y-%m-%d}, for connecting to {', '.join(certificate.names)}\n")
    print(_next_steps(folder, args.name, connects=not args.addresses))


def _next_steps(folder: Path, name: str, *, connects: bool) -> str:
    """Return what to do on the machine; if it ``connects``, it has no address for others to connect to."""
    keys = "/etc/midspan/keys"
    files = " ".join(str(folder / file) for file in ("ca.pem", f"{name}.pem", f"{name}.key"))
    return f"""\
Next, on {name}, as root (the service's user is midspan, unless it was installed with another):
  install -d -o midspan -m 700 {keys}
  install -o midspan -m 600 FILES {keys}
where FILES are these three, copied there:
  {files}
and in its configuration:
  name: {name}
  hub:
    open:
{_snippet(folder, name) if connects else _LISTENS}"""


_LISTENS = """\
      listen: [tls/0.0.0.0:7448]
      trusted: []                     # names of the machines that may command it"""

_EITHER = """\
      connect: [tls/OTHER:7448]       # a name or address in the certificate of OTHER; or, if others connect to it,
      # listen: [tls/0.0.0.0:7448]
      trusted: []                     # names of the machines that may command it"""


def _snippet(folder: Path, name: str) -> str:
    """Return the keys of ``hub.open`` for a machine that connects to the folder's listening machines."""
    from bridge.hub.security.certificates import CertificateError

    others: list[Certificate] = []
    for file in sorted(folder.glob("*.pem")):
        with contextlib.suppress(CertificateError):  # a file that is not a certificate is nothing to connect to
            others += [
                certificate
                for certificate in _certificates(file)
                if not certificate.authority and certificate.name not in ("", name)
            ]
    listening = [
        certificate
        for certificate in others
        if set(certificate.names) - {certificate.name, f"{certificate.name}.local"}
    ]
    if not listening:
        return _EITHER
    endpoints = ", ".join(_endpoint(certificate) for certificate in listening)
    names = ", ".join(certificate.name for certificate in listening)
    return f"""\
      connect: [{endpoints}]
      trusted: [{names}]
and on {names}, so that it may command there: hub.open.trusted: [{name}]"""


def _endpoint(certificate: Certificate) -> str:
    """Return a listening machine's endpoint, by the first ADDRESS of its certificate; IPv6 has brackets and quotes."""
    names = (certificate.name, f"{certificate.name}.local")
    address = next(name for name in certificate.names if name not in names)
    return f"'tls/[{address}]:7448'" if ":" in address else f"tls/{address}:7448"


def _show(paths: list[Path], *, as_json: bool) -> int:
    shown = [certificate for path in paths for certificate in _certificates(path)]
    invalid = any(certificate.days_left() < 0 or certificate.begins_later() for certificate in shown)
    if as_json:
        print(json.dumps([_document(certificate) for certificate in shown], indent=2))
        return int(invalid)
    if not shown:
        raise CliError(f"no certificates in {', '.join(map(str, paths))}; 'midspan keys make NAME' makes them")
    rows = [("NAME", "VALID UNTIL", "LEFT", "CONNECT BY", "FILE"), *(_row(entry) for entry in shown)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    return int(invalid)


def _row(certificate: Certificate) -> tuple[str, ...]:
    left = certificate.days_left()
    remaining = "expired" if left < 0 else f"{left} days"
    return (
        "(authority)" if certificate.authority else certificate.name,
        f"{certificate.until:%Y-%m-%d}",
        f"not before {certificate.since:%Y-%m-%d %H:%M} UTC" if certificate.begins_later() else remaining,
        ", ".join(certificate.names) or "-",
        str(certificate.file),
    )


def _certificates(path: Path) -> list[Certificate]:
    from bridge.hub.security.certificates import read_certificate

    # decided by the suffix, because the default folder may be missing
    files = [path] if path.suffix and not path.is_dir() else sorted(path.glob("*.pem"))
    return [read_certificate(file) for file in files]


def _document(certificate: Certificate) -> dict[str, Any]:
    return {
        "file": str(certificate.file),
        "name": certificate.name,
        "authority": certificate.authority,
        "issuer": certificate.issuer,
        "names": list(certificate.names),
        "since": certificate.since.isoformat(),
        "until": certificate.until.isoformat(),
        "days_left": certificate.days_left(),
    }


def _default_folder() -> Path:
    base = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(base) / "midspan" / "keys"


def _days(text: str) -> int:
    days = int(text) if text.isascii() and text.isdigit() else 0
    if not 1 <= days <= MAX_DAYS:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of days from 1 to {MAX_DAYS}")
    return days
