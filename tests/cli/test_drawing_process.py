"""The figures of a large study, drawn by two processes: the report is the same to the byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from study.api import study
from study.api.study import report
from study.harness.execution.local import Worker


def files(folder: Path) -> dict[Path, bytes]:
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_second_process_changes_no_byte(done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[str] = []

    class Watched(Worker):
        def begin(self, call, *arguments):  # type: ignore[no-untyped-def]
            begun.append(call.func.__name__)
            return super().begin(call, *arguments)

    monkeypatch.setattr(study, "Worker", Watched)
    monkeypatch.setattr(study, "default_jobs", lambda: 2)
    report("small", reports=done / "one", formats=["html"])
    assert not begun
    monkeypatch.setattr(study, "MANY_CASES", 1)
    report("small", reports=done / "two", formats=["html"])
    assert begun == ["of_study"]
    one, two = files(done / "one"), files(done / "two")
    assert any(path.name == "figure-curves.svg" for path in one)
    assert one == two


def test_one_core_draws_by_itself(done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "default_jobs", lambda: 1)
    monkeypatch.setattr(study, "MANY_CASES", 1)
    monkeypatch.setattr(study, "Worker", None)
    assert report("small", reports=done / "one").report is not None
