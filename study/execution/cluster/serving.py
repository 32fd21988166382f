"""What a worker of the cluster does: found there by its name."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Mapping

from study.execution.cluster.isolation import HERE
from study.execution.task import Perform

#: folder of each run's files, and where it has the copy of each file of the study's machine
_COPIES: dict[str, tuple[str, Mapping[str, str]]] = {}


def keep_files(run: str, files: Mapping[str, bytes]) -> None:
    """Keep copies of the files that the tasks of a run read, until the run ends.

    Parameters
    ----------
    run : str
        Name of the run.
    files : mapping of str to bytes
        Content of each file by its path on the machine of the study.
    """
    folder = tempfile.mkdtemp(prefix="study-")
    copies = {}
    for path, content in files.items():
        name = hashlib.sha256(path.encode()).hexdigest()[:16] + os.path.splitext(path)[1]
        copies[path] = os.path.join(folder, name)
        with open(copies[path], "wb") as stream:
            stream.write(content)
    _COPIES[run] = folder, copies


def serve(
    place: tuple[str, int], perform: Perform, text: str, limit_s: float | None
) -> tuple[str, str]:
    """Do one task on a worker: what the cluster calls.

    Parameters
    ----------
    place : tuple of str and int
        Name of the run and number of its slot.
    perform : callable
        Does one task.
    text : str
        The task as JSON.
    limit_s : float or None
        Wall-clock limit in seconds.

    Returns
    -------
    text : str
        JSON of the result.
    death : str
        How its process died; empty if it lived.
    """
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def unwanted() -> bool:
        known = worker.state.tasks.get(key)
        return known is None or known.state in ("cancelled", "released", "forgotten")

    for path, copy in _COPIES.get(place[0], ("", {}))[1].items():
        text = text.replace(json.dumps(path), json.dumps(copy))
    answer = HERE.perform(place, perform, text, limit_s, unwanted)
    return answer.text, answer.death


def end_run(run: str) -> None:
    """End the processes of a run on this worker, and remove its files.

    Parameters
    ----------
    run : str
        Name of the run, as in the place of :func:`serve`.
    """
    HERE.end(run)
    folder, _ = _COPIES.pop(run, ("", {}))
    if folder:
        shutil.rmtree(folder, ignore_errors=True)
