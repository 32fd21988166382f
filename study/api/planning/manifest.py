"""What a run of a study is, before anything of it is computed."""

from __future__ import annotations

from pathlib import Path

from study.api.comparison.design_changes import read_truths
from study.design.load import dump
from study.record.document import ManifestDocument
from study.runner.job import Work
from study.runner.provenance import versions


def manifest_of(work: Work) -> ManifestDocument:
    """Say what a study is, before anything of it is computed.

    Parameters
    ----------
    work : Work
        Every case of the study, with its measurements.

    Returns
    -------
    dict
        Manifest for the store, with versions of today and no timings yet.
    """
    return {
        "name": work.design.name,
        "design": dump(work.design),
        "text": work.design.text,
        "source": Path(work.design.source).name,
        "cases": work.input_hashes,
        "blocks": list(work.blocks),
        "notes": list(work.notes),
        "files": dict(work.files),
        "virtual": work.virtual,
        "truths": read_truths(work.data.root, work.files),
        "versions": versions(),
        "timings": {},
    }
