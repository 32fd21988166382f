"""The program as a process: help, pipes, signals, completion; what it and the README promise."""

import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from contextlib import chdir, redirect_stdout
from pathlib import Path

import pytest

import study as package
from study import api
from study.cli.app import app
from study.harness.design import load
from study.record.record import table
from study.record.store import Store
from tests.cli.small import study, success
from tests.waiting import CAP_S

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COUNTED = r"\d+/12 cases, \d+/12 calibrations"
PROGRAM = (sys.executable, "-c", "from study.cli import main; main()")


def verbs():
    return {str(info.callback.__name__) for info in app.registered_commands if info.callback}


def test_help_names_every_verb_and_readers_that_leave_early_are_no_error(home):
    shown = success("--help").out
    assert all(verb in shown for verb in verbs())
    assert "the table [measurements] that reads it" in success("inspect", "--help").out
    assert success("--version").out == f"study {package.__version__}\n"
    command = " ".join(f"'{part}'" for part in PROGRAM) + " plan small.toml --data data | head -1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert done.stdout.startswith("small:")


HANGUP = pytest.param(signal.SIGHUP, marks=(pytest.mark.slow, pytest.mark.verify))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, HANGUP])
def test_interruption_is_130_and_resumable(home, number):
    with subprocess.Popen(
        [*PROGRAM, "run", "small.toml", "--data", "data", "--jobs", "1"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # a shell in the background hands on that Ctrl-C is ignored, nohup that SIGHUP is
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    ) as process:  # fmt: skip
        assert process.stderr is not None
        # the first line of progress: the first computation is stored
        assert any(
            re.search(r"\d+/\d+ cases, \d+/\d+ calibrations", line) for line in process.stderr
        )
        # held, for the rest of it may take less time than the question
        process.send_signal(signal.SIGSTOP)
        during = study("status", "small")
        process.send_signal(number)
        process.send_signal(signal.SIGCONT)
        _, words = process.communicate(timeout=CAP_S)
    assert process.returncode == 130
    assert "To resume:\n  study run small.toml --data data --jobs 1\n" in words
    assert "Traceback" not in words
    assert re.search(rf"running: {COUNTED}, .+ left \(pid {process.pid}, ", during.out)
    state = study("status", "small", "--json").json
    # what is finished is kept, and nothing half-finished counts
    assert state["cases"]["done"] + state["cases"]["missing"] == 12
    resumed = api.run("small.toml", data="data", jobs=1, reports=None)
    assert (len(resumed.records), resumed.failed) == (12, 0)
    assert state["running"] is None


def test_the_program_as_a_function_leaves_the_signals_of_its_caller(home, monkeypatch):
    """A handler left behind made of any later SIGTERM, in whatever ran then, an interruption."""
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]

    def interrupted(*given, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("study.api.plan", interrupted)
    answer = study("plan", "small.toml", "--data", "data")
    assert (answer.code, "interrupted" in answer.err) == (130, True)
    assert before == [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]


def test_the_end_of_a_file_is_no_interruption(home, monkeypatch):
    """The parser takes it for a user who left a prompt; the program has none."""

    def truncated(*given, **options):
        raise EOFError("Ran out of input")

    monkeypatch.setattr("study.api.plan", truncated)
    with pytest.raises(EOFError, match="Ran out"):
        study("plan", "small.toml", "--data", "data")


def test_what_the_readme_names_exists():
    (text,) = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)
    loaded = load.loads(text, "README.md")
    assert [factor.name for factor in loaded.factors] == ["material", "test.interface"]
    named = set(re.findall(r"(?:^|`)study ([a-z]+)\b", README, re.MULTILINE))
    assert named
    assert named <= verbs()
    files = re.findall(r"\]\(([^)#:]+)\)", README) + re.findall(r"designs/[\w-]+\.toml", README)
    assert files
    assert [name for name in files if not (ROOT / name).is_file()] == []
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^make ([a-z]+)", README, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def commands(answer):
    """Return the indented commands that follow the line of the next step."""
    assert answer.code in (0, 1), answer.err
    return [
        line.strip()
        for line in (answer.out + answer.err).splitlines()
        if line.startswith("  study ")
    ]


def typed(command):
    program, *arguments = shlex.split(command)
    assert program == "study"
    return study(*arguments)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("study re", {"report", "require"}),
        ("study plan --au", {"--augment"}),
        ("study status d", {"designs/", "disc"}),
        ("study run designs/", {"designs/disc.toml"}),
        ("study analyze d", {"designs/", "disc", "discs.csv"}),
        ("study why 0", {"0a1b"}),
        ("study verify x", set()),
        ("study report --results designs d", {"designs/"}),
    ],
)
def test_a_shell_completes_verbs_options_studies_designs_tables_and_cases(
    inside, monkeypatch, words, expected
):
    """The last word is not finished."""
    for name in ("designs/disc.toml", "discs.csv", "notes.txt", "results/disc/cases/0a1b/x"):
        (inside / name).parent.mkdir(parents=True, exist_ok=True)
        (inside / name).touch()
    monkeypatch.setenv("_STUDY_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
    out = io.StringIO()
    with redirect_stdout(out), pytest.raises(SystemExit):
        app(prog_name="study")
    assert set(out.getvalue().split()) == expected


@pytest.mark.usefixtures("inside")
def test_a_new_file_runs_with_the_commands_that_are_named():
    """From nothing to a plan with its cases, typing only what was printed."""
    make, plan = commands(study("new", "mine.toml"))
    assert plan == "study plan mine.toml"
    # without measurements a plan names the same command that makes them
    assert commands(typed(plan)) == [make]
    assert commands(typed(make)) == [plan]
    planned = typed(plan)
    assert "48 cases: 0 done, 0 failed, 48 missing" in planned.out
    assert "8 cells in 6 blocks" in planned.out
    assert commands(planned) == ["study run mine.toml"]


def test_measurements_elsewhere_are_named_again(home):
    (told,) = commands(study("virtual", "else where", "--from", "small.toml"))
    assert told == "study plan small.toml --data 'else where'"
    (run,) = commands(typed(told))
    assert run == "study run small.toml --data 'else where'"


BOTH = "designs/measurements", "measurements"


@pytest.mark.parametrize("places", [*((place,) for place in (*BOTH, "designs")), BOTH])
def test_measurements_are_found_beside_a_design(home, places):
    """A folder that exists and lacks the file hides no other; of two complete ones it is the first.

    The first is that beside the design for the files of a folder `designs`.
    """
    for folder in BOTH:
        (home / folder).mkdir(parents=True)
    (home / "small.toml").rename(home / "designs" / "small.toml")
    rows = (home / "data" / "tests.csv").read_text()
    for number, place in enumerate(reversed(places)):
        (home / place / "tests.csv").write_text(rows if not number else rows.replace("M1", "X"))
    planned = study("plan designs/small.toml --json")
    assert planned.json["blocks"] == ["M1", "M2", "M3"]
    assert planned.json["next"] == "study run designs/small.toml"


def test_a_finished_study_names_what_checks_it(done):
    planned = study("plan", "small.toml", "--data", "data")
    (again,) = commands(planned)
    assert again == "study report small"
    (page,) = commands(typed(again))  # the design asks for tables alone
    assert page == "study report small --format html"
    (check,) = commands(typed(page))
    assert check == "study verify small"
    checked = typed(check)
    assert checked.code == 0, checked.out
    assert "all agree" in checked.out


@pytest.mark.usefixtures("inside")
def test_a_study_that_was_named_by_its_folder_and_settings_are_named_again(done):
    (page,) = commands(study(f"report {done}/results/small --format csv"))
    assert page == f"study report small --results {done}/results --format html"
    options = "small.toml --data data --jobs 1 -s measurements.points=31 --results r"
    with chdir(done):
        (run,) = commands(study(f"plan {options}"))
    assert run == f"study run {options}"


def test_hash_seed_language_and_clock_change_no_digit(home, finished):
    """F37: what surrounds a run changes no digit of it; the other run has those of this process."""
    changed = {"PYTHONHASHSEED": "4711", "LC_ALL": "de_DE.UTF-8", "TZ": "Pacific/Auckland"}
    done = subprocess.run(
        [sys.executable, "-m", "study", "run", "small.toml", "--data", "data", "--jobs", "1",
         "--json"],
        env={**os.environ, **changed, "PYTHONPATH": str(ROOT)}, capture_output=True, check=True,
    )  # fmt: skip
    assert json.loads(done.stdout)["verdicts"] == finished.answer.json["verdicts"]
    tables = []
    for folder in (home, finished.folder):
        store = Store(folder / "results" / "small")
        manifest = store.read_manifest()
        assert manifest is not None
        frame = table(store.records(manifest["cases"])).drop(columns=["seconds"])
        tables.append(frame.to_json(double_precision=15))
    assert tables[0] == tables[1]
