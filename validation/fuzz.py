"""Random and damaged inputs through the command line: an answer or a refusal in words, always.

    python -m validation.fuzz --examples 10000 --seed 2011 [--kind KIND] [--start N]

Kinds: verbs (every verb of the program, see ``fuzz_verbs.py``), and designs, tables, surfaces,
records, folders (``fuzz_inputs.py``); ``all``, the default, draws them in the shares of ``MIX``.
Example N of a seed is always the same: ``--start N --examples 1`` repeats it alone and prints all
that it said, ``--keep DIR`` leaves its files there. One example in 50 runs as a process of its own,
as from a shell. STUDY_DATA names the measured data. Of every verb is asked that

* no exception escapes, none shows in what it prints or writes, and the exit code is a documented
  one, with a sentence where it is not 0;
* nothing is created, changed or deleted outside the project folder, and no process survives;
* it takes at most 10 s of processor time, ends at all, and adds at most 1 GB of memory.

Prints failures as they come, then a table by verb, which Ctrl-C brings early. Exit code 0, 1 if
there was a failure, 2 for bad input.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import io
import multiprocessing
import os
import re
import resource
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from study.cli.app import VERBS, run
from validation import fuzz_verbs
from validation.apart import Apart
from validation.fuzz_inputs import KINDS as FILE_KINDS
from validation.fuzz_inputs import Place, finish, write_neighbours

KINDS = {**FILE_KINDS, "verbs": fuzz_verbs.every_verb}
#: shares of the kinds
MIX = {"verbs": 70, "tables": 12, "designs": 8, "surfaces": 3, "records": 4, "folders": 3}
#: one example in so many runs as a process of its own
EVERY = 50
#: signals that the program listens to
ENDINGS = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGUSR1)

#: what a verb may take
SECONDS, MEGABYTES = 10.0, 1000.0
#: seconds after which a verb is stopped, and its process if that did not help
HANGS, DEAD = 1200, 1500.0
#: seconds in which the projects are made on the busiest machine: a minute of a processor
PREPARED = 7200.0
#: exit codes of ``study --help`` but that of an interrupt, which nobody sends here
CODES = {0, 1, 2, 3}
#: examples of one process, so that what many leave behind is not memory of the next
TOGETHER = 400
#: bytes that a process may map: who asks for more fails here, not the machine
MAPPED = 3 * 1024**3
#: of capset: its version, and the rights of root to read and write what nobody may
CAPABILITIES, OVERRIDE = 0x20080522, 0b110
#: a bug that was caught and printed is one all the same
BUG = re.compile(
    r"Traceback|internal error|is a bug|verdict table could not|"
    r"(?<!raises )\b(Key|Value|Type|Attribute|Index|"  # an exported function says what it raises
    r"Assertion|ZeroDivision|Recursion|Runtime|Name|UnboundLocal|LinAlg|Overflow|Memory|Unicode\w*|"
    r"FloatingPoint|NotImplemented)Error\b"
)
#: what libraries keep for themselves: compiled kernels, fonts, the semaphores of a pool
OWN = re.compile(
    r"/__pycache__(/|$)|^/proc/\d+/clear_refs$|^/dev/(null|shm/(sem|loky|joblib))|/matplotlib"
    r"|/study/kernels-|/joblib|/loky-"
)
#: audited calls that change the disk, which of their arguments are names, and which follow links
WRITES = {
    "open": (0,), "os.rename": (0, 1), "os.remove": (0,), "os.rmdir": (0,), "os.mkdir": (0,),
    "os.symlink": (1,), "os.link": (1,), "os.chmod": (0,), "os.truncate": (0,), "os.utime": (0,),
}  # fmt: skip
FOLLOW = {"open", "os.chmod", "os.truncate", "os.utime"}


class Hang(BaseException):
    """A verb that does not end; nothing that expects errors may catch it."""


@dataclass
class Outcome:
    """What an example did; plain data, for it comes from another process."""

    number: int
    commands: list[str] = field(default_factory=list)
    codes: list[int] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    seconds: float = 0.0
    megabytes: float = 0.0
    said: str = ""

    @property
    def accepted(self) -> bool:
        """Whether every verb did what it was asked; a server is at work until it is stopped."""
        fine = [c == 0 or (c == 130 and w.startswith("serve")) for c, w in self.answers]
        return bool(fine) and all(fine)

    @property
    def answers(self) -> list[tuple[int, str]]:
        """Exit code and words of every verb that ran."""
        return list(zip(self.codes, self.commands, strict=False))


class Audit:
    """Names outside a folder that this process would write to; a hook cannot be taken out."""

    def __init__(self, temporary: str) -> None:
        self._home, self._temporary = "", os.path.realpath(temporary) + os.sep
        self.found: set[str] = set()
        sys.addaudithook(self._hook)

    def look(self, home: Path | None) -> None:
        """Look on while a verb works in a folder, from now on or no more."""
        self._home = "" if home is None else os.path.realpath(home)

    def _hook(self, event: str, given: tuple[Any, ...]) -> None:
        if not self._home or event not in WRITES:
            return
        flags = given[2] if event == "open" and isinstance(given[2], int) else os.O_WRONLY
        if not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC):
            return
        for name in (given[k] for k in WRITES[event]):
            if isinstance(name, (str, bytes, os.PathLike)):
                folder, last = os.path.split(os.path.abspath(os.fsdecode(name)))
                place = os.path.join(os.path.realpath(folder), last)
                if event in FOLLOW and not flags & os.O_NOFOLLOW:
                    place = os.path.realpath(place)
                inside = (place + os.sep).startswith((self._home + os.sep, self._temporary))
                # making a folder that is there, or opening one to write, is refused by the system
                there = event in ("os.mkdir", "open") and os.path.isdir(place)
                if not inside and not there and not OWN.search(place):
                    self.found.add(f"{event} {place}")


#: of this process, made where :func:`examine` is called first
_AUDIT: list[Audit] = []


def snapshot(sandbox: Path) -> dict[str, object]:
    """Everything beside the project folder: kind and rights, size, time, and content."""
    found: dict[str, object] = {}
    for folder, folders, names in os.walk(sandbox):
        folders[:] = [name for name in folders if Path(folder, name) != sandbox / "project"]
        for path in (Path(folder, name) for name in (*folders, *names)):
            state = path.lstat()
            content = path.read_bytes() if stat.S_ISREG(state.st_mode) else b""
            found[str(path)] = (state.st_mode, state.st_size, state.st_mtime_ns, content)
    return found


def children() -> Iterator[str]:
    """Command lines of processes that this one left running, but for the trackers of a pool."""
    started: list[str] = []
    for thread in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):  # of a thread that has just ended
            started += thread.read_text().split()
    for pid in started:
        with contextlib.suppress(OSError):
            line = Path("/proc", pid, "cmdline").read_text().replace("\0", " ")
            if line and "resource_tracker" not in line:  # of a zombie it is empty
                yield line[:80]


def command(words: Sequence[str], outcome: Outcome, apart: bool = False) -> None:
    """Run a verb in this process as the shell would, and note what is wrong with its answer."""
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    code = -1
    handlers = {number: signal.getsignal(number) for number in ENDINGS}
    cpu = _processor_seconds()
    signal.alarm(HANGS)
    try:
        if apart:
            code = _as_process(words, out, err)
        elif words[:1] == ["serve"]:
            code = _served(words, out, err, outcome)
        else:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = run(list(words))
    except BaseException as error:  # noqa: BLE001 - whatever escapes is what is looked for
        frames = traceback.extract_tb(error.__traceback__)
        last = [frame for frame in frames if "/study/" in frame.filename][-1]
        where = f"{last.filename.rpartition('/study/')[2]}:{last.lineno} {last.name}"
        outcome.faults.append(f"{type(error).__name__} in {where}: {str(error)[:160]!r}")
        outcome.said += traceback.format_exc()
    finally:
        signal.alarm(0)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    seconds = _processor_seconds() - cpu
    texts = [s.buffer.getvalue().decode(errors="replace") for s in (out, err)]
    outcome.seconds = max(outcome.seconds, seconds)
    outcome.codes.append(code)
    outcome.said += f"$ study {' '.join(words)}\n{texts[0]}{texts[1]}exit {code}\n"
    outcome.faults += [f"late: took {seconds:.1f} s"] if seconds > SECONDS else []
    outcome.faults += wrong(code, texts[0], texts[1], words[:1] == ["serve"]) if code != -1 else []


def _processor_seconds() -> float:
    """Seconds of this process and of those that it has ended; a busy machine changes nothing."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime


def _as_process(words: Sequence[str], out: io.TextIOWrapper, err: io.TextIOWrapper) -> int:
    """Run a verb as a shell does."""
    line = [sys.executable, "-m", "study", *words]
    ended = subprocess.run(line, capture_output=True, timeout=HANGS, check=False)
    out.buffer.write(ended.stdout)
    err.buffer.write(ended.stderr)
    return ended.returncode


def _served(
    words: Sequence[str], out: io.TextIOWrapper, err: io.TextIOWrapper, outcome: Outcome
) -> int:
    """Serve for as long as it takes to read some pages, then press Ctrl-C."""

    def read_pages() -> None:
        try:
            for _ in range(200):
                if found := re.search(
                    rb"http://127\.0\.0\.1:\d+", cast(io.BytesIO, out.buffer).getvalue()
                ):
                    break
                time.sleep(0.05)
            else:
                return
            links = ["/"]
            for k in range(6):
                with urllib.request.urlopen(found[0].decode() + links[k], timeout=30) as answer:
                    page = answer.read().decode(errors="replace")
                outcome.faults += bugs(page, f"the page {links[k]}")
                links += [
                    href for href in re.findall(r'href="(/[^"]*)"', page) if href not in links
                ]
                if len(links) <= k + 1:
                    return
        except urllib.error.HTTPError as error:
            outcome.faults += [f"a page answers {error.code}"] if error.code >= 500 else []
        except OSError as error:
            outcome.faults.append(f"a page gives no answer: {type(error).__name__}")
        finally:
            os.kill(os.getpid(), signal.SIGUSR1)

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGUSR1, interrupt)
    reader = threading.Thread(target=read_pages, daemon=True)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        reader.start()
        code = run(list(words))
        signal.signal(signal.SIGUSR1, signal.SIG_IGN)
    reader.join(15)
    return code


def wrong(code: int, out: str, err: str, served: bool = False) -> Iterator[str]:
    """Say what is wrong with an answer; of exit code 1 the answer itself may be the sentence."""
    # a run that can write no further ends as one that was interrupted (README)
    stopped = served or ("could not be written" in err and "To resume:" in err)
    if code not in CODES and not (stopped and code == 130):
        yield f"exit code {code} is documented nowhere"
    if code and len((err if code > 1 else out + err).split()) < 3:
        yield f"exit code {code} without a sentence"
    yield from bugs(out + err, "its words")


def bugs(text: str, where: str) -> Iterator[str]:
    """First bug that stands in a text, with what stands beside it."""
    if found := BUG.search(text):
        near = " ".join(text[max(found.start() - 70, 0) : found.end() + 90].split())
        yield f"{found[0]} in {where}: {near!r}"


def written(project: Path) -> Iterator[str]:
    """Bugs that stand in what was written: a case that raised, a figure that is missing."""
    for path in (*project.rglob("record.json"), *project.rglob("*.html")):
        with contextlib.suppress(OSError):
            if stat.S_ISREG(path.lstat().st_mode) and path.stat().st_size < 10**7:
                yield from bugs(path.read_text(errors="replace"), f"a {path.suffix[1:]} file")


def examine(kind: str, seed: int, number: int, place: Place, keep: str) -> dict[str, Any]:
    """Build an example in a sandbox of its own, and run its verbs; to be called apart."""
    if not _AUDIT:
        _may_start_workers()
        resource.setrlimit(resource.RLIMIT_AS, (MAPPED, MAPPED))
        signal.signal(signal.SIGALRM, _hang)
        tempfile.tempdir = os.environ["TMPDIR"] = os.path.join(place.campaign, "temporary")
        os.makedirs(tempfile.tempdir, 0o777, exist_ok=True)
        os.chmod(tempfile.tempdir, 0o1777)
        _AUDIT.append(Audit(tempfile.tempdir))
    sandbox = Path(tempfile.mkdtemp(dir=keep or place.campaign, prefix=f"{kind}-{number}-"))
    sandbox.chmod(0o755)
    project, outcome = sandbox / "project", Outcome(number)
    project.mkdir()
    try:
        write_neighbours(sandbox, place)
        rng = np.random.default_rng([seed, sorted(KINDS).index(kind), number])
        base = _resident("VmRSS", True)
        commands, modest = KINDS[kind](rng, project, place)
        outcome.commands = [" ".join(words) for words in commands]
        before = snapshot(sandbox)
        _verbs(commands, project, modest, outcome)
        outcome.megabytes = _resident("VmHWM") - base
        after = snapshot(sandbox)
        changed = sorted(k for k in {*before, *after} if before.get(k) != after.get(k))
        outcome.faults += [f"changed outside: {name}" for name in changed[:3]]
        outcome.faults += [f"left running: {line}" for line in children()]
        left = Path(tempfile.gettempdir()).glob("study*")
        outcome.faults += [f"left behind: {path.name}" for path in left]
    finally:
        os.chdir(place.campaign)
        if not keep:
            shutil.rmtree(sandbox, ignore_errors=True)
    if outcome.megabytes > MEGABYTES:
        outcome.faults.append(f"memory: grew by {outcome.megabytes:.0f} MB")
    return asdict(outcome)


def _resident(key: str, forget: bool = False) -> float:
    """Resident memory of this process in MB, now or at its peak; the peak can be forgotten."""
    if forget:
        with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as stream:
            stream.write("5")
    text = Path("/proc/self/status").read_text()
    return float(text.partition(key + ":")[2].split()[0]) / 1024


def _hang(number: int, frame: object) -> None:
    raise Hang(f"no end within {HANGS} s")


def obey(modes: bool) -> None:
    """Let the modes of files hold for root as well, or no more; others obey them anyway."""
    libc, head = ctypes.CDLL(None), (ctypes.c_uint32 * 2)(CAPABILITIES, 0)
    sets = (ctypes.c_uint32 * 6)()  # effective, permitted, inheritable; twice 32 bits
    libc.capget(head, sets)
    sets[0] = sets[1] & ~OVERRIDE if modes else sets[1]
    libc.capset(head, sets)


def _verbs(commands: Sequence[Sequence[str]], project: Path, modest: bool, note: Outcome) -> None:
    """Run verbs one after the other, without rights where rights are what is examined."""
    os.chdir(project)
    _AUDIT[0].found.clear()
    _AUDIT[0].look(project)
    obey(modest)
    try:
        for words in commands:
            apart = note.number % EVERY == 0 and words[0] not in ("serve", "demo")
            with fuzz_verbs.small_demo():
                command(words, note, apart)
    finally:
        obey(False)
        _AUDIT[0].look(None)
    note.faults += [f"wrote outside: {name}" for name in sorted(_AUDIT[0].found)[:3]]
    if {words[0] for words in commands} & {"run", "report"}:
        note.faults += written(project)


def _may_start_workers() -> None:
    """Take this process for none that the library of processes forbids to have children."""
    multiprocessing.current_process().daemon = False


def ready_project(place: Place, kind: str) -> None:
    """Make what examples copy: a finished study, and the project of all verbs."""
    _may_start_workers()
    if kind in ("all", "records", "folders"):
        finish("records", place)
    if kind in ("all", "verbs"):
        fuzz_verbs.prepare(place.campaign)


def drawn(kind: str, seed: int, number: int) -> str:
    """Kind of an example."""
    if kind != "all":
        return kind
    share = np.array(list(MIX.values()))
    return str(np.random.default_rng([seed, number]).choice(list(MIX), p=share / share.sum()))


def campaign(given: argparse.Namespace, place: Place) -> Iterator[Outcome]:
    """Every example of the campaign; a process that hangs or dies costs one of them."""
    keep = str(given.keep.resolve()) if given.keep else ""
    with Apart() as process:
        ready = process.ask(ready_project, (place, given.kind), PREPARED)
        if not ready.ok:
            raise RuntimeError(f"the projects to be damaged could not be made: {ready.message}")
        for number in range(given.start, given.start + given.examples):
            kind = drawn(given.kind, given.seed, number)
            answer = process.ask(examine, (kind, given.seed, number, place, keep), DEAD)
            fault = f"{answer.status}: {answer.message}"
            outcome = Outcome(**answer.value) if answer.ok else Outcome(number, faults=[fault])
            yield outcome
            spent = outcome.seconds > SECONDS or outcome.megabytes > MEGABYTES
            if spent or (number + 1) % TOGETHER == 0:
                process.close()


def shown(kind: str, outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Lines of every kind of failure, with its number of examples, and of the table."""
    alike: dict[str, list[int]] = {}
    for outcome in outcomes:
        for name in {re.sub(r"/\S*/project|\d+\.?\d*", "#", f)[:110] for f in outcome.faults}:
            alike.setdefault(name, []).append(outcome.number)
    for name, numbers in sorted(alike.items(), key=lambda item: -len(item[1])):
        yield f"{len(numbers):>6} x, first {numbers[0]}: {name}"
    codes = Counter(code for outcome in outcomes for code in outcome.codes)
    yield "exit codes: " + ", ".join(f"{codes[code]} x {code}" for code in sorted(codes))
    by_verb: dict[str, list[Outcome]] = {verb.__name__: [] for verb in VERBS}
    for outcome in outcomes:
        for verb in dict.fromkeys(words.partition(" ")[0] for words in outcome.commands):
            by_verb.setdefault(verb, []).append(outcome)
    yield "verb         drawn  accepted  refused  faults  mean s      s    MB  slowest"
    for verb, rows in (*sorted(by_verb.items()), (kind, list(outcomes))):
        if not rows:
            yield f"{verb:<11}{0:>7}"
            continue
        fine, faulty = sum(o.accepted for o in rows), sum(bool(o.faults) for o in rows)
        slow = max(rows, key=lambda o: o.seconds)
        mean, most = sum(o.seconds for o in rows) / len(rows), max(o.megabytes for o in rows)
        yield (
            f"{verb:<11}{len(rows):>7}{fine / len(rows):>10.0%}{len(rows) - fine:>9}{faulty:>8}"
            f"{mean:>8.2f}{slow.seconds:>7.1f}{most:>6.0f}  {slow.number}"
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print failures and the table; 0 without a failure, 1 with one, 2 for bad input."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    shared = Path(__file__).resolve().parents[2] / "shared" / "data"
    data = str(Path(os.environ.get("STUDY_DATA", shared)).resolve())
    parser.add_argument("--kind", choices=["all", *sorted(KINDS)], default="all")
    parser.add_argument("--examples", type=int, default=10_000, help="how many (10000)")
    parser.add_argument("--seed", type=int, default=2011, help="of the campaign (2011)")
    parser.add_argument("--start", type=int, default=0, help="number of the first example (0)")
    parser.add_argument("--keep", type=Path, help="folder in which sandboxes are left")
    given = parser.parse_args(arguments)
    if given.examples < 1 or min(given.seed, given.start) < 0:
        parser.error("needs --examples >= 1, --seed >= 0 and --start >= 0")
    outcomes, said = [], time.monotonic()
    with tempfile.TemporaryDirectory(prefix="fuzz-", ignore_cleanup_errors=True) as home:
        os.chmod(home, 0o755)
        with contextlib.suppress(KeyboardInterrupt):
            for outcome in campaign(given, Place(home, data)):
                outcomes.append(outcome)
                for fault in outcome.faults:
                    tried = "; ".join(outcome.commands)
                    print(
                        f"{given.kind} {outcome.number}: {fault[:400]} [{tried[:400]}]", flush=True
                    )
                if given.examples == 1:
                    print(outcome.said)
                if time.monotonic() - said >= SECONDS:
                    said = time.monotonic()
                    print(f"... {len(outcomes)} of {given.examples} {given.kind}", flush=True)
    if outcomes:
        print(*shown(given.kind, outcomes), sep="\n")
    return 1 if any(outcome.faults for outcome in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
