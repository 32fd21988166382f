"""F37: what surrounds a run (hash seed, language, time zone) changes no digit of it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from study.harness.record.record import table
from study.harness.record.store import Store
from tests.cli.small import write_files

SURROUNDINGS = (
    {"PYTHONHASHSEED": "0", "LC_ALL": "C", "TZ": "UTC"},
    {"PYTHONHASHSEED": "4711", "LC_ALL": "de_DE.UTF-8", "TZ": "Pacific/Auckland"},
)


def test_hash_seed_language_and_clock_change_no_digit(tmp_path: Path) -> None:
    found = []
    for number, changed in enumerate(SURROUNDINGS):
        home = tmp_path / str(number)
        home.mkdir()
        write_files(home)
        command = [sys.executable, "-m", "study", "run", "small.toml", "--data", "data",
                   "--jobs", "1", "--json"]  # fmt: skip
        surroundings = {**os.environ, **changed, "PYTHONPATH": str(Path(__file__).parents[2])}
        done = subprocess.run(command, cwd=home, env=surroundings, capture_output=True, check=True)
        verdicts = json.loads(done.stdout)["verdicts"]
        store = Store(home / "results" / "small")
        manifest = store.read_manifest()
        assert manifest is not None
        frame = table(store.records(manifest["cases"])).drop(columns=["seconds"])
        found.append((frame.to_json(double_precision=15), verdicts))
    assert found[0] == found[1]
