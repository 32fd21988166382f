"""Machine code on disk: found by a second process, never older than its sources."""

import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import study.ground.compilation
from study.ground.compilation import fault_of
from tests.fem.problems import long_verification

CALLEE = """
from compiled import kernel
@kernel()
def answer():
    return {answer}
"""
CALLER = """
from compiled import kernel
from callee import answer
@kernel()
def ask():
    return 1 * answer()
print(ask(), ask.stats.cache_hits.get((), 0))
"""
SIGNATURES = """
import sys
import numpy as np
from compiled import kernel
@kernel()
def total(x):
    return x.sum() + 1.0
print(total(np.ones((1,) * int(sys.argv[1]))), sum(total.stats.cache_hits.values()))
"""
#: the elements' forces and stiffness in an uneven state
DIGITS = """
import hashlib
import numpy as np
from tests.fem.homogeneous import system_of
from tests.fem.problems import MOONEY
from study.mechanics.element.assembly import assemble
system = system_of(MOONEY, element_order="quadratic")
x = system.start().x + 1e-3 * np.sin(np.arange(system.space.n))
system.internal.evaluate(MOONEY, x, system.tangent)
print(hashlib.sha256(system.data.tobytes()).hexdigest())
print(sum(assemble.stats.cache_hits.values()))
"""


def run(folder, *command, **variables):
    """Run another process in a folder."""
    return subprocess.run(
        [sys.executable, *command], cwd=folder, env={**os.environ, **variables},
        capture_output=True, text=True, check=True,
    )  # fmt: skip


def result_and_hits(folder):
    """Result of the caller, and whether it came from the cache."""
    result, hits = run(folder, "caller.py", XDG_CACHE_HOME=str(folder / "cache")).stdout.split()
    return int(result), int(hits)


def program(folder, caller=CALLER):
    """Write a kernel that calls another one, which answers 41."""
    shutil.copy(study.ground.compilation.__file__, folder / "compiled.py")
    (folder / "caller.py").write_text(caller)
    (folder / "callee.py").write_text(CALLEE.format(answer=41))


def test_a_change_in_another_file_is_seen(tmp_path):
    """A callee of another file and a constant of one without kernels are compiled into them.

    Numba alone would go on with the old answer: the caller's file is the same.
    """
    caller = CALLER.replace("1 *", "FACTOR *").replace("@", "from constant import FACTOR\n@", 1)
    for clone, factor in [("first", 1), ("second", 1), ("third", 2)]:
        folder = tmp_path / clone
        folder.mkdir()
        program(folder, caller)
        (folder / "constant.py").write_text(f"FACTOR = {factor}")
        (folder / "cache").symlink_to(tmp_path)
    assert result_and_hits(tmp_path / "first") == (41, 0)
    assert result_and_hits(tmp_path / "second") == (41, 1)
    assert result_and_hits(tmp_path / "third") == (82, 0)
    (tmp_path / "third" / "callee.py").write_text(CALLEE.format(answer=42))
    assert result_and_hits(tmp_path / "third") == (84, 0)


def together(folder, dimensions):
    """Whether each of several processes at once found its signature on disk."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
    started = [
        subprocess.Popen(
            [sys.executable, "total.py", dimension], cwd=folder, env=environment,
            stdout=subprocess.PIPE, text=True,
        )
        for dimension in dimensions
    ]  # fmt: skip
    found = [process.communicate()[0].split() for process in started]
    assert all(float(result) == 2.0 for result, _ in found)
    return [hits for _, hits in found]


@long_verification
def test_of_processes_at_once_one_compiles(tmp_path):
    """The others wait, and no process loses the entry of another in a kernel's index."""
    shutil.copy(study.ground.compilation.__file__, tmp_path / "compiled.py")
    (tmp_path / "total.py").write_text(SIGNATURES)
    assert sorted(together(tmp_path, "1123")) == ["0", "0", "0", "1"]
    assert together(tmp_path, "123") == ["1", "1", "1"]


def test_a_folder_that_cannot_be_locked_is_used_without(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr(study.ground.compilation, "cache_folder", lambda: tmp_path / "file")
    with study.ground.compilation.only_process("work"):
        assert [path.name for path in tmp_path.iterdir()] == ["file"]


#: what numba reads first in a cache, from a pickle that touches a file
PLANTED = """
import pathlib, pickle, sys
class Touch:
    def __reduce__(self):
        return pathlib.Path.touch, (pathlib.Path(sys.argv[1], "ran"),)
for index in pathlib.Path(sys.argv[1]).rglob("*.nbi"):
    index.write_bytes(pickle.dumps(Touch()))
    print(index)
"""


def test_a_cache_that_others_can_write_is_not_read(tmp_path):
    """Its files are run: a planted one would have the rights of whoever starts a study."""
    program(tmp_path, CALLER.replace("callee import answer", "callee import *"))
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    ask = partial(run, tmp_path, "caller.py", TMPDIR=str(temporary))
    cache = tmp_path / "cache"
    assert ask(XDG_CACHE_HOME=str(cache)).stdout == "41 0\n"
    assert (cache / "study").stat().st_mode & 0o777 == 0o700
    assert len(run(tmp_path, "-c", PLANTED, str(cache)).stdout.split()) == 2
    shutil.copytree(cache / "study", tmp_path / "elsewhere")
    (cache / "study").chmod(0o770)
    refused = ask(XDG_CACHE_HOME=str(cache))
    assert refused.stdout == "41 0\n"
    assert f"others have rights in {cache / 'study'} (mode 770)" in refused.stderr
    assert f"rm -r {cache / 'study'}" in refused.stderr
    assert not (cache / "ran").exists()
    # what was compiled then is kept in the folder for temporary files, and any variable of numba
    # or relative path is ignored
    (folder,) = (tmp_path / "elsewhere").glob("kernels-*")
    again = ask(
        HOME="/dev/null", XDG_CACHE_HOME="elsewhere", NUMBA_CACHE_DIR=str(folder),
        NUMBA_CACHE_LOCATOR_CLASSES="InTreeCacheLocator",
    )  # fmt: skip
    assert (again.stdout, again.stderr) == ("41 1\n", "")
    assert not (cache / "ran").exists()


def test_whoever_can_replace_a_folder_can_write_it(tmp_path):
    place = tmp_path / "parent" / "study"
    place.mkdir(parents=True, mode=0o700)
    place.chmod(0o700)
    assert fault_of(place) is None
    (tmp_path / "link").symlink_to(place)
    assert fault_of(tmp_path / "link") is None
    (tmp_path / "parent").chmod(0o757)
    assert f"chmod go-w {tmp_path / 'parent'}" in str(fault_of(place))
    assert fault_of(tmp_path / "link") is not None
    (tmp_path / "parent").chmod(0o1777)  # as /tmp: only the owner replaces what lies there
    assert fault_of(place) is None


def digits(cache):
    """Hash of the elements' stiffness, and how many kernels came from the cache."""
    root = Path(__file__).parents[2]
    found, hits = run(root, "-c", DIGITS, XDG_CACHE_HOME=str(cache)).stdout.split()
    return found, int(hits)


@long_verification
def test_the_process_that_compiles_gets_the_same_digits(tmp_path):
    """A study stopped in its first minute and resumed holds cases of both processes."""
    compiled, none = digits(tmp_path)
    found, hits = digits(tmp_path)
    assert (none, hits) == (0, 1)
    assert found == compiled
