"""Archives whose bytes depend only on the commit, so that two builds are equal.

Times, order, owners and modes are normalized (https://reproducible-builds.org/docs/). All times are
``$SOURCE_DATE_EPOCH``, by default the time of the commit.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import io
import os
import subprocess
import tarfile
import time
import zipfile
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def epoch() -> int:
    """Return the time of all files in the archives, in seconds since 1970."""
    text = os.environ.get("SOURCE_DATE_EPOCH") or _of_commit()
    if not text.isdecimal():
        raise RuntimeError(f"SOURCE_DATE_EPOCH is {text!r}; it must be seconds since 1970, such as 1767225600")
    return int(text)


def _of_commit() -> str:
    command = ["git", "log", "-1", "--format=%ct"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout.strip()


def mode(bits: int) -> int:
    """Return a file's mode without the influence of the umask."""
    return 0o755 if bits & 0o100 else 0o644


def repack_sdist(sdist: Path) -> None:
    """Write a source distribution again with normalized members."""
    packed, seconds = io.BytesIO(), epoch()
    with tarfile.open(sdist) as old, tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as new:
        for member in sorted(old.getmembers(), key=lambda member: member.name):
            normal = tarfile.TarInfo(member.name)
            normal.type, normal.size, normal.mode, normal.mtime = member.type, member.size, mode(member.mode), seconds
            new.addfile(normal, old.extractfile(member))
    sdist.write_bytes(gzip.compress(packed.getvalue(), mtime=seconds))


def rewrite_wheel(wheel: Path, added: Mapping[str, str]) -> None:
    """Write a wheel again with normalized members, and with added files in its folder ``.dist-info``."""
    with zipfile.ZipFile(wheel) as archive:
        files = {info.filename: (archive.read(info), info.external_attr >> 16) for info in archive.infolist()}
    (record,) = (name for name in files if name.endswith(".dist-info/RECORD"))
    del files[record]
    folder = record.removesuffix("RECORD")
    files |= {f"{folder}{name}": (text.encode(), 0o644) for name, text in added.items()}
    files = dict(sorted(files.items(), key=lambda item: (item[0].startswith(folder), item[0])))
    lines = "".join(f"{name},sha256={_digest(data)},{len(data)}\n" for name, (data, _) in files.items())
    files[record] = f"{lines}{record},,\n".encode(), 0o644
    date = time.gmtime(epoch())[:6]
    with zipfile.ZipFile(wheel, "w") as archive:
        for name, (data, bits) in files.items():
            info = zipfile.ZipInfo(name, date)
            info.external_attr = (0o100000 | mode(bits)) << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data)


def _digest(data: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
