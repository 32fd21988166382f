"""Whatever is read from a file goes through ``study.ground.files``; who does not says why."""

import ast
from functools import cache
from pathlib import Path

import pytest

from tests.house import trees

ROOT = Path(__file__).parents[1]

READER = "study/ground/files.py"
#: methods and functions that open a file, or parse what somebody else may have written
OPENS = {
    "open", "open_code", "fdopen", "FileIO", "read_text", "read_bytes", "mmap", "memmap",
    "fromfile", "loadtxt", "genfromtxt", "decompress", "GzipFile", "BZ2File", "LZMAFile",
    "ZipFile", "TarFile", "unpack_archive", "read_parquet", "read_excel", "read_json",
    "read_table", "read_pickle", "read_hdf",
}  # fmt: skip
#: the same, where the name before the dot decides: a method ``load`` may be of anything
OPENS_OF = {
    ("np", "load"), ("numpy", "load"), ("json", "load"), ("json", "loads"), ("tomllib", "load"),
    ("pd", "read_csv"), ("pandas", "read_csv"), ("meshio", "read"), ("vtu", "read"),
    ("stl", "read"), ("ply", "read"), ("obj", "read"), ("ElementTree", "parse"),
    ("pickle", "load"), ("yaml", "safe_load"),
}  # fmt: skip
#: functions of ours with one of these names, and modules whose functions they are
OURS = {"read_csv", "read_table", "read_json", "read_text", "read_bytes"}
READERS = {"declaration", "files", "tabular", "tidy_csv", "self"}
WRITING = {"w", "wb", "x", "xb", "a", "ab"}

EXCEPTIONS = {
    "study/ground/working_folder.py: open": "a handle of the folder to return to",
    "study/external/answers.py: open": "a process, which is no file",
    "study/harness/design/load.py: read_text": "a file of the package",
    "study/reporting/output/page.py: read_text": "a file of the package",
    "study/ground/compilation.py: read_bytes": "sources of the package",
    "study/simulation/provenance.py: read_text": "sources of the package, and their hash",
    "study/simulation/solve_task.py: open": "memory of this process, from /proc",
    "study/execution/local.py: read_text": "memory of the machine, from /proc",
    "study/external/launcher.py: open": "4 kB of /proc, in a program without this package",
    "study/cli/app.py: open": "/dev/null, to be written to",
    "study/cli/study_commands.py: json.loads": "a record, read and written again in memory",
    "study/execution/local.py: open": "a pool of processes",
    **{
        f"study/mechanics/surface/closed_surface.py: {kind}.read": "behind the reader's checks"
        for kind in ("stl", "ply", "obj")
    },
    "study/laboratory/shape/boundary.py: vtu.read": "a parser behind the reader's checks",
}


def calls_of(tree):
    """Names of the calls that open a file for reading, or parse what was read."""
    calls = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            # a parser may be handed on by name, too
            if (node.value.id, node.attr) in OPENS_OF:
                calls.add(f"{node.value.id}.{node.attr}")
        elif not isinstance(node, ast.Call) or _writes(node):
            continue
        elif isinstance(node.func, ast.Name) and node.func.id in OPENS - OURS:
            calls.add(node.func.id)
        elif isinstance(node.func, ast.Attribute) and node.func.attr in OPENS:
            before = node.func.value.id if isinstance(node.func.value, ast.Name) else ""
            if before not in READERS and (before, node.func.attr) not in OPENS_OF:
                calls.add(node.func.attr)
    return calls


def _writes(call):
    """Whether a call opens a file to write it anew: nothing that is there is read."""
    if (
        isinstance(call.func, ast.Name)
        and call.func.id == "open"
        or isinstance(call.func, ast.Attribute)
        and call.func.attr == "ZipFile"
    ):
        modes = call.args[1:2]
    elif isinstance(call.func, ast.Attribute) and call.func.attr == "open":
        modes = call.args[:2]  # of a path, or of a module such as gzip
    else:
        return False
    modes = [*modes, *(word.value for word in call.keywords if word.arg == "mode")]
    return any(isinstance(m, ast.Constant) and m.value in WRITING for m in modes)


@cache
def found(root):
    return {f"{path.as_posix()}: {call}" for path, tree in trees(root) for call in calls_of(tree)
            if path.as_posix() != READER}  # fmt: skip


def test_files_are_read_by_one_function():
    assert found(ROOT) - set(EXCEPTIONS) == set()


def test_no_exception_stands_for_nothing():
    assert set(EXCEPTIONS) - found(ROOT) == set()
    assert len(EXCEPTIONS) <= 25  # may only fall


READS = (
    "open('x')", "open('x', 'rb')", "open('x', 'r+')", "Path('x').open()", "Path('x').read_text()",
    "path.read_bytes()", "gzip.open(path)", "gzip.decompress(b)", "np.load('x')",
    "json.load(stream)", "json.loads(text)", "pd.read_csv('x')", "os.open(path, 0)",
    "np.loadtxt('x')", "tomllib.load(stream)", "read = {'.stl': stl.read}",
    "zipfile.ZipFile('x')", "pd.read_table('x')",
)  # fmt: skip
WRITES = (
    "open('x', 'w')", "Path('x').open('xb')", "open('x', mode='w')", "read_table(kind)",
    "zipfile.ZipFile(stream, 'w')",
)  # fmt: skip


@pytest.mark.parametrize("code", [*READS, *WRITES])
def test_the_search_sees_a_reader_and_lets_a_writer_pass(code):
    assert bool(calls_of(ast.parse(code))) == (code in READS)
