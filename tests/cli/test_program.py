"""The program as a process: help, pipes, interruption; and what the README promises."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from study import api
from study.cli.app import app
from study.harness.design import load
from tests.cli.small import study
from tests.waiting import CAP_S

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COUNTED = r"\d+/12 cases, \d+/12 calibrations"
PROGRAM = (sys.executable, "-c", "from study.cli import main; main()")


def test_help_names_every_verb() -> None:
    done = subprocess.run([*PROGRAM, "--help"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for verb in verbs():
        assert verb in done.stdout


def verbs() -> set[str]:
    return {str(info.callback.__name__) for info in app.registered_commands if info.callback}


def test_readers_that_leave_early_are_no_error(home: Path) -> None:
    command = " ".join(f"'{part}'" for part in PROGRAM) + " plan small.toml --data data | head -1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert done.stdout.startswith("small:")


HANGUP = pytest.param(signal.SIGHUP, marks=(pytest.mark.slow, pytest.mark.verify))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, HANGUP])
def test_interruption_is_130_and_resumable(home: Path, number: int) -> None:
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


def test_the_program_as_a_function_leaves_the_signals_of_its_caller(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A handler left behind made of any later SIGTERM, in whatever ran then, an interruption."""
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]

    def interrupted(*given: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("study.api.plan", interrupted)
    answer = study("plan", "small.toml", "--data", "data")
    assert (answer.code, "interrupted" in answer.err) == (130, True)
    assert before == [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]


def test_the_end_of_a_file_is_no_interruption(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The parser takes it for a user who left a prompt; the program has none."""

    def truncated(*given: object, **options: object) -> None:
        raise EOFError("Ran out of input")

    monkeypatch.setattr("study.api.plan", truncated)
    with pytest.raises(EOFError, match="Ran out"):
        study("plan", "small.toml", "--data", "data")


def test_the_design_of_the_readme_loads() -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)
    loaded = load.loads(text, "README.md")
    assert [factor.name for factor in loaded.factors] == ["material", "test.interface"]


def test_every_verb_of_the_readme_exists() -> None:
    named = set(re.findall(r"(?:^|`)study ([a-z]+)\b", README, re.MULTILINE))
    assert named
    assert named <= verbs()


def test_every_file_that_the_readme_names_exists() -> None:
    named = re.findall(r"\]\(([^)#:]+)\)", README) + re.findall(r"designs/[\w-]+\.toml", README)
    assert named
    for name in named:
        assert (ROOT / name).is_file(), name


def test_every_target_of_the_readme_exists() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^make ([a-z]+)", README, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
