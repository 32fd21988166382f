"""Whether a worker would give the numbers of this machine."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping

from study.execution.cluster.connection import first_line

#: names and versions of what decides a number, asked of this machine and of every worker
Identity = Callable[[], Mapping[str, str]]

#: kinds of difference that are listed before "and ... more"
LISTED = 4
#: how an error of an import begins as text
_IMPORT = re.compile(r"(ImportError|ModuleNotFoundError|AttributeError)\b")
#: what is said of a package that is not there
ABSENT = "absent"


def about(identity: Identity) -> dict[str, str]:
    """Versions of this machine, Dask's included.

    Parameters
    ----------
    identity : callable
        Gives names and versions of what decides a number.
    """
    import distributed

    return {**identity(), "distributed": str(distributed.__version__)}


def differences(here: Mapping[str, str], there: object) -> str:
    """Say what differs between this machine and a worker; empty if nothing does.

    Parameters
    ----------
    here : mapping of str to str
        Versions of this machine, by name.
    there
        Those of the worker; or the error, itself or as text, that it gave in their stead.
    """
    if not isinstance(there, Mapping):
        told = first_line(there) if isinstance(there, BaseException) else str(there)
        # the scheduler hands over errors of a worker as text
        is_import = isinstance(there, ImportError) or _IMPORT.match(told) is not None
        return f"study cannot be imported there: {told}" if is_import else told
    return ", ".join(
        f"{name} {there.get(name, ABSENT)} (here {here.get(name, ABSENT)})"
        for name in dict.fromkeys([*here, *there])
        if here.get(name) != there.get(name)
    )


def refusal(different: Mapping[str, str]) -> str:
    """Say which workers cannot be used and why, those with the same differences together.

    Parameters
    ----------
    different : mapping of str to str
        What differs, by the address of each worker that cannot be used; one at least.
    """
    alike = Counter(different.values())
    lines = [
        f"    {count} worker{'s' if count > 1 else ''}: {told}"
        for told, count in alike.most_common(LISTED)
    ]
    if len(alike) > LISTED:
        lines.append(f"    and {len(alike) - LISTED} more kinds of difference")
    return (
        "workers of the cluster would not give the numbers of this machine:\n"
        + "\n".join(lines)
        + "\n    install the same versions there: python -m pip install --require-hashes -r\n"
        "    requirements.lock, then study itself"
    )
