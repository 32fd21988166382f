"""What is handed on: a complete source distribution, and a lock file with all that is needed."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: what a repository has besides its sources
APART = (".git", ".gitignore", "results/", "reports/")


def test_the_source_distribution_holds_every_file_of_the_repository(tmp_path):
    pytest.importorskip("setuptools", minversion="77", reason="the build needs setuptools 77")
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.split("\n")
    kept = {name for name in listed if name and not name.startswith(APART)}
    if not kept:
        pytest.skip("this is no repository")
    copy = tmp_path / "copy"
    for name in kept:
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, copy / name)
    build = "from setuptools import build_meta; import sys; build_meta.build_sdist(sys.argv[1])"
    subprocess.run(
        [sys.executable, "-c", build, str(tmp_path)], cwd=copy, check=True, capture_output=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path[1:])},
    )  # fmt: skip
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        held = {name.partition("/")[2] for name in packed.getnames()}
    assert {name for name in kept if (ROOT / name).is_file()} - held == set()


def canonical(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def test_the_lock_file_has_every_dependency_with_a_hash_and_names_no_index():
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert "://" not in text
    rows = re.findall(r"^(\S+)==(\S+) \\\n    --hash=sha256:([0-9a-f]{64})$", text, re.MULTILINE)
    assert len(rows) == text.count("==") == text.count("--hash")
    locked = {canonical(name) for name, _, _ in rows}
    with (ROOT / "pyproject.toml").open("rb") as stream:
        project = tomllib.load(stream)["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *extras["fast"], *extras["test"]]
    for one in list(wanted):  # an extra may be made of others
        for name in re.findall(r"^study\[(.+)\]", one):
            wanted += [needed for extra in name.split(",") for needed in extras[extra.strip()]]
    wanted = [one for one in wanted if not one.startswith("study[")]
    names = {canonical(re.match(r"[\w.-]+", one)[0]) for one in wanted}
    assert names - locked == set()
