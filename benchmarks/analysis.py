"""Seconds and memory of `study analyze` on large tables: python -m benchmarks.analysis.

Each table has a process of its own, after a small one, so that imports are left out. Three
factors of 4, 5 and 5 levels with all interactions, balanced and with a seventh of the rows lost;
in blocks, every cell once in each block.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from study.api.analyzing import analyze
from study.reporting.output.analysis_page import AnalysisSource as Source
from study.reporting.output.analysis_page import write_page

#: rows, kind, seconds asked of the analysis
CASES = (
    (10_000, "balanced", 2.0),
    (10_000, "unbalanced", 2.0),
    (10_000, "blocks", 2.0),
    (100_000, "balanced", 15.0),
    (100_000, "unbalanced", 15.0),
    (100_000, "blocks", 15.0),
)
FACTORS = ("A", "B", "C")
CELLS = 4 * 5 * 5


def table(rows: int, kind: str) -> pd.DataFrame:
    """Random table with an effect of A and an interaction of B and C."""
    rng = np.random.default_rng(1)
    i = np.arange(rows)
    levels = {"A": i % 4, "B": i // 4 % 5, "C": i // 20 % 5}
    y = 10 + levels["A"] + 0.5 * levels["B"] * (levels["C"] == 2) + rng.standard_normal(rows)
    frame = pd.DataFrame({name: code.astype(str) for name, code in levels.items()})
    frame = frame.assign(block=(i // CELLS).astype(str), y=y)
    if kind == "unbalanced":
        frame = frame.drop(index=rng.choice(rows, rows // 7, replace=False).tolist())
    return frame


def measure(rows: int, kind: str) -> dict[str, float]:
    """Seconds of the analysis and of its page, and the peak of the memory."""
    block = "block" if kind == "blocks" else None
    with tempfile.TemporaryDirectory() as folder:
        small, large = Path(folder) / "small.csv", Path(folder) / "large.csv"
        table(4 * CELLS, kind).to_csv(small, index=False)
        table(rows, kind).to_csv(large, index=False)
        write_page(analyze(small, "y", FACTORS, block=block, practical=0.5), folder)
        start, cpu = time.perf_counter(), time.process_time()
        found = analyze(large, "y", FACTORS, block=block, practical=0.5)
        done, cpu_done = time.perf_counter(), time.process_time()
        write_page(found, folder, source=Source(large))
        page = time.perf_counter() - done
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"wall_s": done - start, "cpu_s": cpu_done - cpu, "page_s": page, "peak_MB": peak}


def main() -> None:
    if len(sys.argv) == 3:
        print(json.dumps(measure(int(sys.argv[1]), sys.argv[2])))
        return
    print(
        f"{'rows':>8} {'kind':12} {'wall s':>8} {'cpu s':>8} {'asked s':>8} {'page s':>8} {'MB':>6}"
    )
    for rows, kind, asked in CASES:
        command = [sys.executable, "-m", "benchmarks.analysis", str(rows), kind]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        m = json.loads(done.stdout)
        print(
            f"{rows:8,} {kind:12} {m['wall_s']:8.2f} {m['cpu_s']:8.2f} {asked:8.1f} "
            f"{m['page_s']:8.2f} {m['peak_MB']:6.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
