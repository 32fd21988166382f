"""What a calibration says: constants and what they rest on, several tests compared, energies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from study.reporting.content.blocks import Block, Document, Table, Verbatim
from study.reporting.content.text import between, general, p_phrase

Columns = dict[str, Callable[[tuple[str, Document]], str]]


def calibration_blocks(document: Document) -> Iterator[Block]:
    """Constants with their intervals, then the curves, the verdicts and what to measure next."""
    bound = document.get("numerics") or document.get("numerical")
    columns: Columns = {
        "constant": lambda of: of[0],
        "value": lambda of: general(of[1]["value"], 6),
        "unit": lambda of: of[1]["unit"],
        "standard error": lambda of: general(of[1]["standard_error"]),
        "95 % interval": lambda of: between(of[1]["ci95"]),
    }
    if bound is not None:
        columns["numerics"] = lambda of: f"+-{general(bound['u'][of[0]], 2)}"
    if document["profiles"]:
        profiles = document["profiles"]
        columns["profile interval"] = lambda of: between(profiles.get(of[0], {}).get("interval"))
    yield Table.of(document["model"], document["parameters"].items(), columns)
    yield from nuisance_blocks(document["nuisance"])
    if "shear_moduli" in document:
        both = document["shear_moduli"]
        yield Verbatim(
            f"shear modulus at small strain: {general(both['instantaneous'], 5)} kPa at once, "
            f"{general(both['long_term'], 5)} kPa after all relaxation"
        )
    if "converted" in document:
        converted = document["converted"]
        values = ", ".join(f"{n} = {general(v, 6)}" for n, v in converted["constants"].items())
        note = f" ({converted['note']})" if converted["note"] else ""
        head = f"{converted['convention']}: {converted['keyword']}"
        yield Verbatim(f"{head}: {values} in MPa{note}")
    if bound is not None:
        yield Verbatim(bound["sentence"])
    if "bootstrap" in document:
        drawn = document["bootstrap"]
        ends = "; ".join(
            f"{n} {between(pair)} {document['parameters'][n]['unit']}".rstrip()
            for n, pair in drawn["interval"].items()
        )
        yield Verbatim(f"{drawn['sentence']}: {ends}")
    if document["serial_correlation"]:
        yield Verbatim(_serial(document["serial_correlation"]))
    yield from _curves("", document["curves"])
    for kind, title in (("specimens", "alone"), ("cross_validation", "left out")):
        for fit in document[kind]:
            values = ", ".join(
                f"{n} {general(e['value'], 5)} {e['unit']}".rstrip()
                for n, e in fit["parameters"].items()
            )
            yield Verbatim(f"{fit['label']} {title}: {values} ({fit['status']})")
            yield from _curves("  ", fit["curves"])
    if document["population"]:
        of_specimens: Columns = {
            "constant": lambda of: of[0],
            "specimens": lambda of: str(of[1]["specimens"]),
            "mean": lambda of: general(of[1]["mean"], 5),
            "unit": lambda of: of[1]["unit"],
            "scatter": lambda of: general(of[1]["standard_deviation"]),
            "95 % of the mean": lambda of: between(of[1]["mean_ci95"]),
            "95 % of the next specimen": lambda of: between(of[1]["next_ci95"]),
        }
        yield Table.of("population of specimens", document["population"].items(), of_specimens)
        for name, entry in document["population"].items():
            listed = ", ".join(f"{k} {general(v, 5)}" for k, v in entry["shrunk"].items())
            yield Verbatim(
                f"{name} of each specimen, shrunk to the mean by its own error: {listed}"
            )
    yield from _judged(document)


def nuisance_blocks(nuisance: Document) -> Iterator[Block]:
    """Nuisance parameters and the share that each has in the variance of the constants."""
    if not nuisance:
        return

    def expected(entry: Document) -> str:
        u = entry["uncertainty"]
        return general(entry["expected"]) + ("" if u is None else f" +- {general(u)}")

    columns: Columns = {
        "nuisance parameter": lambda of: of[0],
        "": lambda of: of[1]["treated"],
        "expected": lambda of: expected(of[1]),
        "found": lambda of: general(of[1]["value"]),
        "unit": lambda of: of[1]["unit"],
        "95 % interval": lambda of: between(of[1]["ci95"], 4),
    }
    for name in next(iter(nuisance.values()))["shares"]:
        columns[f"share in {name}"] = lambda of, name=name: (  # type: ignore[misc]
            f"{general(100 * of[1]['shares'][name], 3)} %"
        )
    yield Table.of("nuisance parameters", nuisance.items(), columns)
    if any(entry["treated"] == "fitted" and entry["uncertainty"] for entry in nuisance.values()):
        yield Verbatim(
            "the expected value of a fitted parameter enters the fit as one row that nobody "
            "measured (a pseudo-observation)"
        )


def _judged(document: Document) -> Iterator[Block]:
    if document["same_constants_p"] is not None:
        yield Verbatim(
            f"all specimens share their constants: {p_phrase(document['same_constants_p'])}"
        )
    if document["lack_of_fit"]:
        lack = document["lack_of_fit"]
        yield Verbatim(
            f"{lack['verdict']}: F = {general(lack['statistic'])}, "
            f"{p_phrase(lack['p_independent'])} if every point is independent, "
            f"{p_phrase(lack['p_dependent'])} if every curve is"
        )
    yield Verbatim(
        f"{document['status']}: {document['message']} ({document['evaluations']} evaluations)"
    )
    yield Verbatim(f"{document['fit']['verdict']}: {document['fit']['sentence']}")
    verdict = "identifiable" if document["identifiable"] else "not identifiable"
    scaled = document["identifiability"]["sentence"] if document["identifiability"] else ""
    whys = "; ".join(why for why in (document["reason"], scaled) if why)
    yield Verbatim(f"{verdict}{': ' + whys if whys else ''}")
    if document["next_test"] and document["next_test"]["sentence"]:
        yield Verbatim(document["next_test"]["sentence"])
    yield Verbatim(document["stability"])
    yield from (Verbatim(f"data: {note}") for note in document["notes"])


def _serial(serial: Document) -> str:
    if serial["correlation"] is None:
        return f"intervals from {serial['rows']} rows, taken as independent: too few to tell"
    return (
        f"intervals from {serial['rows']} rows, neighbors correlated by "
        f"{serial['correlation']:.2f}: worth {serial['effective_rows']:.3g} independent rows"
    )


def _curves(indent: str, curves: Sequence[Document]) -> Iterator[Verbatim]:
    for curve in curves:
        name = f"{curve['file']}, {curve['specimen']}" if curve["specimen"] else curve["file"]
        if curve["rms_force_error"] is None:
            outcome = f"no prediction: {curve['message']}"
        else:
            outcome = (
                f"RMS error {general(curve['relative_rms_force_error'], 3)} % of the RMS force "
                f"({general(curve['rms_force_error'], 3)} N), R2 {general(curve['r_squared'], 4)}"
            )
        yield Verbatim(f"{indent}{curve['role']}: {name}: {outcome}")


def comparison_blocks(document: Document) -> Iterator[Block]:
    """Constants of every test by itself, what was seen and what would have been."""

    def with_error(entry: Document) -> str:
        return f"{general(entry['value'], 5)} +- {general(entry['standard_error'], 2)}"

    heads = {
        n: f"{n} [{constant['unit']}]".replace(" []", "")
        for n, constant in document["common"].items()
    }
    columns: dict[str, Callable[[Document], str]] = {
        "test": lambda group: group["label"],
        "n": lambda group: str(group["n"]),
    }
    for name, head in heads.items():
        columns[head] = lambda group, name=name: with_error(group["parameters"][name])  # type: ignore[misc]
    columns |= {
        "mu0 [kPa]": lambda group: general(group["mu0"], 5),
        f"power, {100 * document['difference']:.3g} % off": lambda group: general(
            group["power"], 3
        ),
        "seen with power 0.8": lambda group: (
            "-" if group["detectable"] is None else f"{general(100 * group['detectable'], 3)} %"
        ),
    }
    test_table = Table.of(document["model"], document["groups"], columns)
    common = (with_error(document["common"][name]) for name in heads)
    rows = (*test_table.rows, ("common", "", *common, "", "", ""))
    yield Table(test_table.name, test_table.columns, rows)
    yield Verbatim(f"{document['verdict']}: {document['sentence']}")


def energy_blocks(document: Document) -> Iterator[Block]:
    """Every energy with its weight, and which of them may be chosen."""

    def may_be_chosen(entry: Document) -> str:
        if entry["not_chosen_because"]:
            return f"no: {entry['not_chosen_because']}"
        if entry["energy"] == document["best"]:
            return "best"
        return "not told apart" if entry["energy"] in document["cannot_be_told_apart"] else "yes"

    columns: dict[str, Callable[[Document], str]] = {
        "energy": lambda entry: entry["energy"],
        "constants": lambda entry: str(entry["constants"]),
        "AICc - best": lambda entry: general(entry["delta_aicc"]),
        "weight": lambda entry: general(entry["weight"]),
        "mu0 [kPa]": lambda entry: general(entry["mu0"], 5),
        "the data": lambda entry: entry["verdict"],
        "may be chosen": may_be_chosen,
    }
    yield Table.of("", document["energies"], columns)
    yield from (Verbatim(f"{name}: {why}") for name, why in document["failures"].items())
    yield Verbatim(document["sentence"])
