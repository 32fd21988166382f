"""Check that this machine can import gmsh, and mend it or say how.

The gmsh wheel links graphics libraries that a bare Debian or Ubuntu does not have, and
``import gmsh`` then ends in an OSError. As root the libraries are installed; otherwise the
exact command is printed and the exit code is 1.

Run with the Python of the virtual environment: ``python scripts/system_libraries.py``.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence

PACKAGES = (
    "libglu1-mesa",
    "libgl1",
    "libopengl0",
    "libxcursor1",
    "libxft2",
    "libxinerama1",
    "libxrender1",
    "libxfixes3",
    "libxext6",
    "libfontconfig1",
    "libgomp1",
)

APT = ("apt-get", "install", "-y", "--no-install-recommends")


def import_error(python: str = sys.executable) -> str | None:
    """Last line of what ``import gmsh`` says in a fresh process; None where it works."""
    run = subprocess.run([python, "-c", "import gmsh"], capture_output=True, text=True, check=False)
    if run.returncode == 0:
        return None
    lines = run.stderr.strip().splitlines()
    return lines[-1] if lines else f"import gmsh ended with exit code {run.returncode}"


def is_missing_library(error: str) -> bool:
    """Whether system libraries can mend this error (a missing wheel, they cannot)."""
    return error.startswith("OSError") or "cannot open shared object file" in error


def message(error: str) -> str:
    """Say what is wrong, and the command that mends it."""
    if not is_missing_library(error):
        return (
            f"gmsh cannot be imported: {error}\n"
            "The Python package is missing or broken; set the environment up again:\n"
            "    rm -rf .venv && make setup"
        )
    return (
        f"gmsh cannot be imported: {error}\n"
        "It needs graphics libraries of the system. Install them, then repeat the command:\n"
        f"    sudo apt-get update && sudo {' '.join(APT + PACKAGES)}\n"
        "(on another system than Debian or Ubuntu: its packages of GLU, GL, OpenGL, Xcursor,\n"
        "Xft, Xinerama, Xrender, Xfixes, Xext, fontconfig and the OpenMP runtime of GCC)"
    )


def install(call: Callable[[Sequence[str]], int] = subprocess.call) -> bool:
    """Install the libraries; True where apt-get says that it did."""
    print("installing the system libraries of gmsh: " + " ".join(PACKAGES), flush=True)
    # A stale list of packages is the usual reason of a failure, a failed update is not one.
    call(["apt-get", "update"])
    return call([*APT, *PACKAGES]) == 0


def main(
    check: Callable[[], str | None] = import_error,
    mend: Callable[[], bool] = install,
    may_install: bool | None = None,
) -> int:
    """Exit code: 0 where gmsh can be imported in the end, else 1."""
    error = check()
    if error is None:
        return 0
    if may_install is None:
        may_install = os.geteuid() == 0 and shutil.which("apt-get") is not None
    if may_install and is_missing_library(error) and mend():
        error = check()
    if error is None:
        return 0
    print(message(error), file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
