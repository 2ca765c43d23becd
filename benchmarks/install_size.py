"""What an installation takes on the disk, part by part, in a fresh environment.

    python benchmarks/install_size.py [--extras parquet plots mjcf] [--write PAGE]

makes a virtual environment in a temporary folder, installs this checkout with pip, and
adds the sizes of the files that each wheel has brought, without bytecode.  Optional
parts are installed one after the other; each row has what is new.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from pages import written_to

ROOT = Path(__file__).parent.parent
OWN = ("consistent-id", "pip", "setuptools")
PARTS: Mapping[str, tuple[str, ...]] = {
    "CasADi": ("casadi",),
    "Pinocchio": ("pin", "libpinocchio", "eigenpy", "coal", "libcoal", "cmeel"),
    "CVXPY, Clarabel": (
        *("cvxpy", "clarabel", "sparsediffpy", "qdldl", "cffi", "pycparser"),
        *("scs", "osqp", "highspy"),
    ),
    "NumPy, SciPy": ("numpy", "scipy"),
    "all else": ("",),
}
"""Parts by the names of packages, or what these begin with; the first that fits."""

NAMED = 1.0  # MB; smaller packages are counted among others
SIZES = """
import json
from importlib.metadata import distributions
from pathlib import Path
found = {}
for one in distributions():
    files = [Path(one.locate_file(f)) for f in one.files or () if f.suffix != ".pyc"]
    found[one.metadata["Name"]] = sum(f.stat().st_size for f in files if f.exists())
print(json.dumps(found))
"""


def sizes(python: Path) -> dict[str, float]:
    """Return the size of each package that an environment has [MB]."""
    done = subprocess.run(
        [python, "-c", SIZES], capture_output=True, text=True, check=True
    )
    return {name: size / 1e6 for name, size in json.loads(done.stdout).items()}


def in_parts(packages: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return packages by part, the largest first.

    Examples
    --------
    >>> in_parts({"numpy": 57.0, "cmeel-boost": 181.0})
    {'Pinocchio': {'cmeel-boost': 181.0}, 'NumPy, SciPy': {'numpy': 57.0}}
    """
    found: dict[str, dict[str, float]] = {part: {} for part in PARTS}
    for name, size in sorted(packages.items(), key=lambda item: -item[1]):
        part = next(
            part
            for part, starts in PARTS.items()
            if any(name.lower().startswith(start) for start in starts)
        )
        found[part][name] = size
    return {part: own for part, own in found.items() if own}


def row(part: str, packages: Mapping[str, float]) -> str:
    """Return a row of the table."""
    large = [f"`{n}` {s:.0f}" for n, s in packages.items() if s >= NAMED]
    rest = sum(size for size in packages.values() if size < NAMED)
    others = [f"others {rest:.1f}"] if rest else []
    total = sum(packages.values())
    return f"| {part} | {', '.join([*large, *others])} | {total:.0f} |"


def installed(python: Path, extras: Sequence[str] = ()) -> dict[str, float]:
    """Install the checkout with optional parts; return the sizes of its packages."""
    what = f"{ROOT}[{','.join(extras)}]" if extras else str(ROOT)
    subprocess.run([python, "-m", "pip", "install", "--quiet", what], check=True)
    return {name: s for name, s in sizes(python).items() if name not in OWN}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--extras", nargs="*", default=["parquet", "plots", "mjcf"])
    parser.add_argument("--write", type=Path, help="page with marks of the table")
    options = parser.parse_args()
    with TemporaryDirectory() as folder, written_to(options.write, "size"):
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        python = Path(folder, "bin", "python")
        core = installed(python)
        print(
            f"{len(core)} dependencies of {sum(core.values()):.0f} MB, Python "
            f"{sys.version_info.major}.{sys.version_info.minor}:\n"
        )
        print("| part | packages | MB |\n|---|---|---:|")
        for part, packages in in_parts(core).items():
            print(row(part, packages))
        before = core
        for extra in options.extras:
            after = installed(python, [extra])
            new = {n: s for n, s in after.items() if n not in before}
            new = dict(sorted(new.items(), key=lambda item: -item[1]))
            print(row(f"optional: `{extra}`", new))
            before = after


if __name__ == "__main__":
    main()
