"""The working folder may be a stranger's: nothing in it is imported or configures anything.

Python puts the working folder on ``sys.path`` of ``python -c`` and ``python -m``, with which worker
processes and notebooks start, and some libraries look there for a file of settings. What a user
imports by a line of his own is his affair; what this package imports never comes from there.
"""

# imported before anything else, with the working folder possibly first on the path: only modules
# that the interpreter has loaded or holds frozen may be named here, not even __future__
import _thread
import os
import sys
from importlib.machinery import (
    BYTECODE_SUFFIXES,
    EXTENSION_SUFFIXES,
    SOURCE_SUFFIXES,
    ExtensionFileLoader,
    FileFinder,
    ModuleSpec,
    PathFinder,
    SourceFileLoader,
    SourcelessFileLoader,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import FrameType, ModuleType

_PACKAGE = __name__.partition(".")[0]
_HOME = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
#: libraries that look for a file of settings in the working folder while they are imported
SETTINGS = {"numba": ".numba_config.yaml", "matplotlib": "matplotlibrc"}
#: variables that name files of settings or folders of caches; a relative path is in the working
#: folder, whichever that is
PATH_VARIABLES = (
    "HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MATPLOTLIBRC", "MPLCONFIGDIR", "DASK_CONFIG",
    "DASK_ROOT_CONFIG",
)  # fmt: skip
#: any text keeps the working folder off the path of an interpreter; this one marks who set it
SAFE_PATH = ("PYTHONSAFEPATH", "study")

_LOADERS = (
    (ExtensionFileLoader, EXTENSION_SUFFIXES),
    (SourceFileLoader, SOURCE_SUFFIXES),
    (SourcelessFileLoader, BYTECODE_SUFFIXES),
)


class _WorkingFolderFinder(FileFinder):
    """Modules of the working folder, for the user's imports and for no other."""

    def find_spec(self, fullname: str, target: "ModuleType | None" = None) -> ModuleSpec | None:
        if _package_imports(sys._getframe(1)):
            return None
        return super().find_spec(fullname, target)


class _SettingsFinder:
    """Libraries that read settings in the working folder, imported from another folder."""

    #: working folders that are left while a library is loaded: it imports nothing from them either
    left: "list[str]" = []

    @staticmethod
    def find_spec(
        fullname: str, path: "Sequence[str] | None" = None, target: "ModuleType | None" = None
    ) -> ModuleSpec | None:
        if not os.path.lexists(SETTINGS.get(fullname, "")) or not _package_imports(
            sys._getframe(1)
        ):
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_elsewhere(module: "ModuleType") -> None:
                here = os.open(".", os.O_RDONLY)
                _SettingsFinder.left.append(os.getcwd())
                os.chdir(os.path.dirname(os.path.abspath(__file__)))
                try:
                    load(module)
                finally:
                    os.fchdir(here)
                    os.close(here)
                    _SettingsFinder.left.pop()

            spec.loader.exec_module = load_elsewhere  # type: ignore[method-assign]
        return spec


def keep_out() -> None:
    """Keep the working folder out of every import that this package makes in this process."""
    if not any(finder is _SettingsFinder for finder in sys.meta_path):
        sys.meta_path.insert(0, _SettingsFinder)
        sys.path_hooks.insert(0, _hook)
        for path in [path for path in sys.path_importer_cache if is_working_folder(path)]:
            del sys.path_importer_cache[path]


def is_working_folder(path: str) -> bool:
    """Whether a path is the working folder, and this package does not lie there itself."""
    try:
        here = os.getcwd()
    except OSError:  # it was removed
        return path == ""
    return os.path.realpath(path) in {here, *_SettingsFinder.left} - {_HOME}


def leave() -> None:
    """Take the working folder off the path of this process, and its files out of its variables."""
    # For the command, whose process imports nothing for a user.
    sys.path[:] = [path for path in sys.path if not is_working_folder(path)]
    for name in PATH_VARIABLES:
        value = os.environ.get(name)
        if value and not os.path.isabs(os.path.expanduser(value)):
            del os.environ[name]
            print(
                f"warning: {name}={value} is ignored: a relative path would name files of the "
                "working folder; give the whole path",
                file=sys.stderr,
            )


class UserImports:
    """Context in which this package loads a user's function, with the modules that it is from."""

    #: calls that have opened the context: what this package imports below one of them, or in
    #: another thread, is no import of the user's
    frames: "list[FrameType]" = []

    def __enter__(self) -> None:
        """Let modules of the working folder in."""
        UserImports.frames.append(sys._getframe(1))

    def __exit__(self, *error: object) -> None:
        """Keep them out again."""
        UserImports.frames.remove(sys._getframe(1))


class SafeChildren:
    """Context in which interpreters are started: they search the working folder last or not at all.

    A module of the working folder that a user imported is still met by the name that it has here.
    """

    #: threads of a cluster's worker start processes at the same time
    _lock = _thread.RLock()

    def __enter__(self) -> None:
        """Mark the environment, and put the working folder last on the path that children copy."""
        self._lock.acquire()
        self._variable, self._path = os.environ.get(SAFE_PATH[0]), sys.path
        if not self._variable:
            os.environ[SAFE_PATH[0]] = SAFE_PATH[1]
        users = [path for path in self._path if is_working_folder(path)]
        if users:  # this package may be found by a finder that is asked after the whole path
            others = [path for path in self._path if path not in users]
            sys.path = [*others, _HOME, *users]

    def __exit__(self, *error: object) -> None:
        """Put back what was there."""
        sys.path = self._path
        if self._variable is None:
            os.environ.pop(SAFE_PATH[0], None)
        else:
            os.environ[SAFE_PATH[0]] = self._variable
        self._lock.release()


def environment(is_safe: bool) -> dict[str, str]:
    """Environment of a program as the user set it, with a safe path where it is an interpreter."""
    name, mark = SAFE_PATH
    users = {key: value for key, value in os.environ.items() if (key, value) != (name, mark)}
    return {**users, name: users.get(name) or mark} if is_safe else users


def _hook(path: str) -> FileFinder:
    """Finder of the working folder."""
    if not is_working_folder(path):
        raise ImportError("another finder is for this path")
    return _WorkingFolderFinder(path, *_LOADERS)


def _package_imports(frame: "FrameType | None") -> bool:
    """Whether this package is nearer to an import, in the stack of calls, than a user's code."""
    while frame is not None and frame not in UserImports.frames:
        name = str(frame.f_globals.get("__name__", ""))
        if name.partition(".")[0] == _PACKAGE:
            return True
        folder = os.path.dirname(frame.f_code.co_filename)
        if name == "__main__" or (folder and is_working_folder(folder)):
            return False
        frame = frame.f_back
    return False
