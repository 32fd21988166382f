"""A file with a right checksum and wrong content is damaged, whatever is wrong with it."""

import json

import numpy as np
import pytest

from study.ground.curve import Curve
from study.ground.errors import StoreError
from study.record.record import (
    AdaptiveStep,
    ConfirmedRow,
    CurveKey,
    NumericalRow,
    Record,
    SpaceRow,
    ValidationRow,
    fault_of_comparisons,
    fault_of_series,
    seal,
)
from study.record.store import Store
from tests.record.samples import FIT, NUMERICAL, manifest, record
from validation.damage import Damage, damages, sealed

CURVE = Curve(np.array([1.0, 2.0]), np.array([0.1, 0.3]), np.array([0.1, 0.2]))
FITTED = {
    "key": "f1",
    "message": "a minimum",
    "names": ["C10", "C01"],
    "values": {"C10": 0.005, "C01": 0.001},
    "ci95": {"C10": [0.004, 0.006], "C01": None},
    "correlation": [[1.0, 0.5], [0.5, 1.0]],
    "rss": 0.25,
    "n": 30,
    "identifiable": True,
}


def whole():
    """A record with something of everything that a record may hold."""
    plate = {
        "plate": "rigid",
        "fitted": "all",
        "markers": 3,
        "error_mm": 0.1,
        "error_by_axis_mm": [0.1, 0.1, 0.1],
        "error_by_layer_mm": {"top": 0.1},
        "motion": {"down": [1.0, 0.1]},
    }
    solver = {
        "name": "pardiso",
        "min_j": 0.9,
        "energy_mismatch": 1e-4,
        "stabilization_share": 0.0,
        "snaps_mm": [0.5],
    }
    score = {"score": "B1", "fit": "A", "role": "score", "scatter_N": [0.1, 0.1], "responses": {}}
    retry = {"cause": "timeout", "message": "late", "change": "longer-limit", "what": "4 times"}
    labels = (CurveKey("measured", "B1"), CurveKey("predicted", "B1"))
    return record(
        fit={"A": FITTED},
        curves=dict.fromkeys(labels, CURVE),
        solver=solver,
        mesh={"dofs": 120, "elements": 30, "hash": "m", "mesh_size_mm": 0.5},
        responses={"error": {"value": 1.25, "unit": "%", "u_steps": 0.01}},
        versions={"study": "1", "numpy": "2"},
        extra={
            "directions": [score],
            "markers": [{"state": "B1", "floor_mm": 0.01, "fits": [plate]}],
            "retries": [retry],
        },
    )


SPACE = {
    "levels": {"model.element_order": "2"},
    "unknowns": [100, 1000],
    "depth_mm": 3.0,
    "at_end": 0.001,
    "largest": 0.002,
    "message": "",
}
COMPARISON = {
    "case_id": "a1",
    "levels": {"space": "3d"},
    "block": None,
    "label": "B",
    "role": "score",
    "outside": 0.5,
    "verdict": "beyond",
    "unknown": ["inputs"],
    **{name: [1.0, 2.0] for name in ValidationRow.__annotations__ if name[-2:] in ("_N", "mm")},
}
STEP = {"cells": 12, "q2": {"error": 0.9}, "open": ["error"], "stopped": ""}
CONFIRMED = {"case": "a1", "input": "h-a1", "of": "h"}
SOLUTION = {
    "status": "converged",
    "curve": CURVE.as_dict(),
    "elements": 30,
    "dofs": 120,
    "mesh_hash": "m",
}
SERIES = {**NUMERICAL, "mesh_size": [2.0, 1.0], "series": [1.25, 1.2], "formal_order": 2.0}

#: a stored file, what a study writes there, and how it is read
KINDS = {
    "study": (
        dict(manifest(cases={"a1": "h-a1"}, versions={"numpy": "2"})),
        lambda store: store.read_manifest(),
    ),
    "fits/f1": (FIT | FITTED, lambda store: store.read_fit("f1")),
    "solves/s1": (SOLUTION, lambda store: store.read_solution("s1")),
    "numerical": (
        [SERIES],
        lambda store: store.read_rows("numerical", NumericalRow, fault_of_series),
    ),
    "spaces": ([SPACE], lambda store: store.read_rows("spaces", SpaceRow)),
    "validation": (
        [COMPARISON],
        lambda store: store.read_rows("validation", ValidationRow, fault_of_comparisons),
    ),
    "adaptive": ([STEP], lambda store: store.read_rows("adaptive", AdaptiveStep)),
    "confirmed": ([CONFIRMED], lambda store: store.read_rows("confirmed", ConfirmedRow)),
}


def test_a_whole_record_is_read():
    text = whole().to_json()
    assert Record.from_json(text).to_json() == text


def test_whatever_stands_in_a_record_it_is_read_or_refused_in_words():
    content = json.loads(whole().to_json())["content"]
    refused = []
    for damage in damages(content):
        try:
            Record.from_json(sealed(damage.content).encode(), "r.json")
        except StoreError as error:
            refused.append(str(error))
    assert len(refused) > 1500
    assert all(text.startswith("r.json: ") for text in refused)


@pytest.mark.parametrize("name", KINDS)
def test_whatever_stands_in_another_file_it_is_read_or_set_aside(tmp_path, name):
    content, read = KINDS[name]
    path = tmp_path / f"{name}.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(seal(content))
    assert read(Store(tmp_path))
    for damage in damages(content):
        path.write_text(sealed(damage.content))
        store = Store(tmp_path)
        found = read(store)
        lost = found is None or (found == [] and damage.content != [])
        assert [str(path) in said for said in store.warnings] == [True] * lost, damage


def broken(*place, value=None):
    """Find the damage of a whole record at a place."""
    content = json.loads(whole().to_json())["content"]
    part = content
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    return Damage(place, "", content)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (broken("fit", "A", "n", value=0), "its fit.A.n should be greater than or equal to 1"),
        (broken("fit", "A", "key"), "its fit.A.key should be a valid string"),
        (broken("fit", "A", "names", value=["C10"]), "correlations of other constants"),
        (broken("fit", "A", "ci95", "C10", value=[1]), "its fit.A.ci95.C10 has another length"),
        (broken("responses", "error", "value", value=10**400), "error.value should be a valid"),
        (broken("extra", "directions", value=1), "its extra.directions should be a valid list"),
        (broken("curves", "predicted:B1", "force_N", value=[1]), "columns of unequal length"),
        (broken("curves", "measured:B1", "displacement_mm", value=[1, 9]), "ends before"),
        (broken("curves", value={}), "has no curve predicted:B1"),
    ],
)
def test_what_is_wrong_is_named(damage, said):
    with pytest.raises(StoreError, match="r.json: is no record of a case") as caught:
        Record.from_json(sealed(damage.content).encode(), "r.json")
    assert said in str(caught.value)


def test_what_was_not_finite_when_it_was_written_is_no_damage():
    """A record says null there, and one that its own program refuses is computed for ever."""
    nan = float("nan")
    one = record(responses={"error": {"value": nan, "unit": "%", "u_steps": nan}})
    assert Record.from_json(one.to_json()).responses["error"]["u_steps"] is None
