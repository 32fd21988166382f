"""``study verify``: a digit changed anywhere in a report or its records is found."""

import gzip
import json
import math
import platform
import re
import resource
import shutil
import subprocess
import sys
import zlib
from contextlib import contextmanager
from pathlib import Path

import pytest

from study import api
from tests.cli.small import measured, pressed, responses, study
from tests.waiting import CAP_S

pytestmark = pytest.mark.drawings

DESIGN = pressed(
    '[material]\nmodel = "reduced-polynomial"\nincompressible = true\n'
    '[calibration]\nmethod = "analytic"\n'
    + measured("m.csv")
    + 'block = "specimen"\npoints = 12\nrange = ["1 %", "20 %"]\n'
    + "[factors]\nmaterial.order = [1, 2]\n"
    + responses(relative_rms_force_error="1 pp"),
    study='[study]\nname = "verified"\nquestion = "Does the order matter?"\n',
    radius=14.5,
    height=25,
)


def recorded():
    rows = ["specimen,d,f"]
    for block in range(3):
        for k in range(21):
            d = 5.2 * k / 20
            stretch = 1 - d / 25
            force = (stretch**-2 - stretch) * (7 + 0.5 * block) + 0.02 * math.sin(9 * d + block)
            rows.append(f"s{block},{d!r},{force!r}")
    return "\n".join(rows) + "\n"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("verified")
    (folder / "design.toml").write_text(DESIGN)
    (folder / "m.csv").write_text(recorded())
    found = api.run(
        folder / "design.toml", data=folder, results=folder / "results",
        reports=folder / "reports", jobs=1,
    )  # fmt: skip
    assert found.report is not None
    return folder


def changed_digit(text, pattern):
    """Change the last digit of the first number that a pattern finds."""
    place = re.search(pattern, text).end() - 1
    digit = text[place]
    assert digit.isdigit(), pattern
    return text[:place] + str((int(digit) + 1) % 10) + text[place + 1 :]


#: the verb on a report with a changed digit, at the default tolerance and at none, in one process
TWICE = """
from study.cli.app import run
command = ["verify", "verified", "--json"]
assert run([*command, "--resolve", "2", "--data", "."]) == 1
print("then")
assert run([*command, "--tolerance", "0"]) == 1
"""


def test_another_processor_adds_up_otherwise_agrees_and_hides_no_change(finished, tmp_path):
    """Linear algebra for a processor of 2008 has other last digits, which is told."""
    moved = tmp_path / "elsewhere"
    shutil.copytree(finished, moved)
    numbers = moved / "reports/verified/verified-data/numbers.json"
    numbers.write_text(changed_digit(numbers.read_text(), r"\d\.\d{6}"))
    done = subprocess.run(
        [sys.executable, "-c", TWICE],
        cwd=moved, capture_output=True, text=True, timeout=CAP_S, check=False,
        env={"PYTHONPATH": str(Path(__file__).parents[2]), "PATH": "/usr/bin:/bin",
             "OPENBLAS_CORETYPE": "Nehalem"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    changed, strict = map(json.loads, done.stdout.split("\nthen\n"))
    assert (changed["records"], changed["solved_again"]) == (6, 2)
    # every cell of a figure's table was compared: the count is that of a plain count
    csvs = (moved / "reports/verified").rglob("figure-*.csv")
    number = r"[-+\u2212]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
    counted = sum(len(re.findall(number, one.read_text())) for one in csvs)
    assert changed["numbers"]["figures"] == counted > 100
    assert changed["tolerance"] == 1e-9
    assert len(changed["differences"]) == 1  # every other number agrees
    assert len(strict["differences"]) == changed["rounded"] + 1
    # kernels of x86-64
    assert (changed["rounded"] > 0) or platform.machine() not in ("x86_64", "AMD64")


def test_a_changed_digit_anywhere_is_found(finished, tmp_path):
    moved = tmp_path / "touched"
    shutil.copytree(finished, moved)
    report = moved / "reports/verified"
    data = report / "verified-data"
    planted = {
        "verified.html": (report / "verified.html", r"</header>(?s:.*?)>[^<]*?\d\.\d"),
        "verified-details.html": (report / "verified-details.html", r"<td[^>]*>\d+\.\d+"),
        "cases.csv": (data / "cases.csv", r"\d\.\d+"),
        "figure": (next(iter(sorted(data.glob("figure-*cells.csv")))), r"\d\.\d+"),
        "numbers.json": (data / "numbers.json", r"\d\.\d{3}"),
    }
    for path, pattern in planted.values():
        path.write_text(changed_digit(path.read_text(), pattern))
    packed = data / "curves.csv.gz"
    with gzip.open(packed, "rt") as stream:
        text = stream.read()
    with gzip.open(packed, "wt") as stream:
        stream.write(changed_digit(text, r"\d\.\d\d"))
    found = api.verify("verified", results=moved / "results", reports=moved / "reports")
    told = " ".join(one.where for one in found.differences)
    assert not found.agrees
    for name in (*planted, "curves.csv.gz"):
        assert name in told, name
    # in a sound report, each of these is one line
    assert len(found.differences) == len(planted) + 1


@pytest.mark.slow
def test_a_record_that_was_edited_is_found_and_so_is_one_that_was_sealed_again(finished, tmp_path):
    moved = tmp_path / "edited"
    shutil.copytree(finished, moved)
    record = sorted((moved / "results/verified/cases").glob("*/record.json"))[0]
    record.write_text(changed_digit(record.read_text(), r'"value":\s*\d+\.\d+'))
    found = api.verify("verified", results=moved / "results", reports=moved / "reports")
    assert any(one.where == f"record {record.parent.name}" for one in found.differences)
    shutil.copytree(finished / "results", moved / "results", dirs_exist_ok=True)
    from study.record.record import Record
    from study.record.store import Store

    store = Store(moved / "results/verified")
    old = store.read(record.parent.name)
    responses = {name: {**one, "value": one["value"] * 1.01}
                 for name, one in old.responses.items()}  # fmt: skip
    forged = Record(**{**vars(old), "responses": responses})
    with store.lock():
        store.write(forged)
    api.report(moved / "results/verified", reports=moved / "reports")
    plain = api.verify("verified", results=moved / "results", reports=moved / "reports")
    assert plain.agrees
    again = api.verify(
        "verified", results=moved / "results", reports=moved / "reports", resolve=6, data=moved
    )
    where = f"case {record.parent.name} solved again: "
    assert {one.where for one in again.differences} == {where + name for name in responses}


def test_a_report_that_is_not_there_is_refused_with_a_way_out(tmp_path):
    with pytest.raises(Exception, match="study report NAME"):
        api.verify("nothing", reports=tmp_path, results=tmp_path)


def bomb():
    """Fifty million lines without a word, packed in 50 kB."""
    packer = zlib.compressobj(9, wbits=31)
    lines = b"\n" * (1 << 24)
    return b"".join(packer.compress(lines) for _ in range(3)) + packer.flush()


PLANTED = {
    "curves.csv.gz": (lambda raw: bomb(), "unpacked, holds more than"),
    "cases.csv": (lambda raw: raw * 4 + bytes(100_000), "holds more than"),
    "table-fits.csv": (lambda raw: raw + b"\xff", "is no text in UTF-8"),
    "numbers.json": (lambda raw: b"[" * 100_000, ""),
    "made-from.json": (lambda raw: b"[" * 100_000, ""),
}


@contextmanager
def room_for(size):
    """Let this process have so many more bytes of addresses than it has."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    usual = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + size, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, usual)


def test_a_file_that_cannot_be_read_is_a_difference_and_takes_no_memory(
    finished, tmp_path, monkeypatch
):
    moved = tmp_path / "planted"
    shutil.copytree(finished, moved)
    for name, (change, _) in PLANTED.items():
        path = moved / "reports/verified/verified-data" / name
        path.write_bytes(change(path.read_bytes()))
    monkeypatch.chdir(moved)
    with room_for(1_500_000_000):
        done = study("verify", "verified", "--json")
    assert "Traceback" not in done.err
    assert done.code == 1
    reported = {Path(one["where"].split(":")[0]).name: one["reported"]
                for one in done.json["differences"]}  # fmt: skip
    assert set(reported) == set(PLANTED) - {"made-from.json"}
    for name, (_, said) in PLANTED.items():
        assert said in reported.get(name, ""), name
