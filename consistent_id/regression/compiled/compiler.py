"""Whatever C compiler is there, and a folder of what it has compiled.

The folder is the user's own, and so is each file that is loaded from it; a file appears
whole, by renaming, and its name holds the digest of its content.  Where anything is
wrong there is no compiled code, and no error either: it is never needed.
"""

import ctypes
import logging
import os
import platform
import shutil
import stat
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

SWITCH = "CONSISTENT_ID_COMPILED"
"""The environment variable that turns compiled code off where it is ``0``."""

SWIFT = ("-O1",)
"""The compiler's options for code that is to be there soon."""

_COMPILERS = ("cc", "gcc", "clang")
# Sums and products are fused only where asked: else bits are those of NumPy.
_FLAGS = (
    *("-std=gnu99", "-ffp-contract=off", "-fno-math-errno"),
    *("-shared", "-fPIC", "-w"),
)
_PATIENCE = 120.0  # s: above, something is wrong with the compiler
_KEPT = 64  # compiled files, the youngest
_DIGITS = 24  # of digests in names of files

_log = logging.getLogger(__name__)


def switched_on() -> bool:
    """Return whether compiled code may be used."""
    return os.environ.get(SWITCH, "1") != "0" and os.name == "posix"


def loaded(source: str, name: str, options: Sequence[str] = SWIFT) -> Any | None:
    """Return a function that was compiled before with these options, or None."""
    folder = _folder()
    if folder is None:
        return None
    for path in folder.glob(f"{_key(source, options)}-*.so"):
        try:
            data = path.read_bytes() if _is_own(path) else b""
            if path.stem.endswith(f"-{_digest(data)}"):
                return getattr(ctypes.CDLL(str(path)), name)
        except (OSError, AttributeError) as cause:
            _log.debug("%s: not loaded: %s", path, cause)
    return None


def compiled(source: str, name: str, options: Sequence[str] = SWIFT) -> Any | None:
    """Return a function of C source, compiled now; None if that is not possible.

    The compiler's options say how much it optimises.
    """
    folder, compiler = _folder(), _compiler()
    if folder is None or compiler is None:
        return None
    try:
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            code, result = Path(scratch, "code.c"), Path(scratch, "code.so")
            code.write_text(source)
            call = [compiler, *_FLAGS, *options, *_of_this_machine()[0]]
            subprocess.run(
                [*call, str(code), "-o", str(result)],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=_PATIENCE,
                check=True,
            )
            named = f"{_key(source, options)}-{_digest(result.read_bytes())}.so"
            os.replace(result, folder / named)
        _forget_oldest(folder)
    except (OSError, subprocess.SubprocessError) as cause:
        _log.debug("not compiled: %s", cause)
        return None
    return loaded(source, name, options)


@cache
def _compiler() -> str | None:
    return next((found for c in _COMPILERS if (found := shutil.which(c))), None)


@cache
def _of_this_machine() -> tuple[Sequence[str], str]:
    """Return flags for this processor, and what tells it from others."""
    machine = f"{platform.system()} {platform.machine()}"
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    abilities = next((line for line in lines if line.startswith("flags")), "")
    # A folder may be shared by machines; without a name for this one, any will do.
    return (("-march=native",), machine + abilities) if abilities else ((), machine)


def _key(source: str, options: Sequence[str]) -> str:
    parts = [source, *_FLAGS, *options, _of_this_machine()[1]]
    return _digest("\0".join(parts).encode())


def _digest(data: bytes) -> str:
    return sha256(data).hexdigest()[:_DIGITS]


def _folder() -> Path | None:
    """Return the folder of compiled files if nobody else can write to it."""
    above = os.environ.get("XDG_CACHE_HOME", "")
    try:
        base = Path(above) if os.path.isabs(above) else Path.home() / ".cache"
        folder = base / "consistent_id" / "compiled"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        return folder if _is_own(folder) else None
    except (OSError, RuntimeError) as cause:
        _log.debug("no folder for compiled files: %s", cause)
        return None


def _is_own(path: Path) -> bool:
    """Return whether the user owns it, and others cannot write to it."""
    status = path.lstat()
    others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return status.st_uid == os.getuid() and not others and not path.is_symlink()


def _forget_oldest(folder: Path) -> None:
    by_age = sorted(folder.glob("*.so"), key=lambda path: path.stat().st_mtime)
    for path in by_age[:-_KEPT]:
        path.unlink(missing_ok=True)
