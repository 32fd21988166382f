"""Write requirements.lock: what is installed here, each with the hashes of its files.

    .venv/bin/python scripts/lock.py

Takes the versions of this environment that the package and its extras need, asks the index that
pip is set up with for the hashes of their files, and names no index. Run it after `make newest`
has passed its tests.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements.lock"
#: Python that pyproject.toml promises; that of Debian 12 is 3.11.2
OLDEST = "3.11.0"
HEAD = """\
# Versions and hashes that `make` installs (scripts/setup.sh); written by scripts/lock.py.
# For CPython {version} on {platform}; elsewhere the set-up takes the versions that pyproject.toml
# allows, and says so.
"""


def resolved(extras: str) -> list[tuple[str, str, str]]:
    """Name, version and sha256 of every package that an empty environment would get."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        constraints = Path(folder) / "installed.txt"
        frozen = subprocess.run(
            [sys.executable, "-m", "pip", "freeze", "--exclude-editable"],
            check=True, capture_output=True, text=True,
        ).stdout  # fmt: skip
        constraints.write_text(frozen, encoding="utf-8")
        subprocess.run(
            [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed",
             "--only-binary", ":all:", "--constraint", str(constraints), "--report", str(report),
             f"{ROOT}[{extras}]"],
            check=True,
        )  # fmt: skip
        found = json.loads(report.read_text(encoding="utf-8"))["install"]
    rows = []
    for one in found:
        name, version = one["metadata"]["name"], one["metadata"]["version"]
        asked = one["metadata"].get("requires_python", "")
        if OLDEST not in SpecifierSet(asked):
            sys.exit(f"{name} {version} asks for Python {asked}, pyproject.toml for {OLDEST}: "
                     f"pip install '{name}<{version}' first")  # fmt: skip
        hashes = one["download_info"].get("archive_info", {}).get("hashes", {})
        if "sha256" in hashes:
            rows.append((name, version, hashes["sha256"]))
    return sorted(rows, key=lambda row: row[0].lower())


def main() -> None:
    """Write the lock file."""
    rows = resolved("fast,test")
    version = ".".join(map(str, sys.version_info[:2]))
    lines = [f"{name}=={number} \\\n    --hash=sha256:{sha}" for name, number, sha in rows]
    head = HEAD.format(version=version, platform=f"{sys.platform} x86-64")
    LOCK.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    print(f"{LOCK.name}: {len(rows)} packages")


if __name__ == "__main__":
    main()
