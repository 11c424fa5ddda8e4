"""Fuzz every reader of files by coverage (atheris, libFuzzer); each start continues the corpus and the record of the starts before.

    pip install atheris                     (Linux, in the environment of lmeasure)
    python benchmarks/fuzz_readers.py --corpus FOLDER [--seconds S] [--reader NAME ...] [--write]

Readers and right files are those of `tests/helpers/readers.py`. An input that is not read or refused in one line, or that takes too long,
is kept in FOLDER/found.
--seconds are of each reader. --write writes the table to benchmarks/results/fuzz_readers.md.
"""

import argparse
import hashlib
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from study import options, show, table

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / name) for name in ("helpers", "oracles", "acquisition", "procedures", "rig", "sensors")]

LARGEST = 20_000
"""Bytes of an input."""


def one(name: str, corpus: Path, seconds: float) -> None:
    """Fuzz one reader until the time is over; libFuzzer ends the process."""
    import atheris

    with atheris.instrument_imports(include=["lmeasure"], enable_loader_override=False):
        from readers import judged, readers
    reader = readers()[name]
    own, found = corpus / name.replace(" ", "-"), corpus / "found"
    own.mkdir(parents=True, exist_ok=True)
    found.mkdir(exist_ok=True)
    (own / "right").write_bytes(reader.right)
    scratch = tempfile.TemporaryDirectory()
    known: set[str] = set()

    def tried(data: bytes) -> None:
        wrong = re.sub(r"[0-9'\"]+", "", judged(reader, data, Path(scratch.name)))[:80]
        if wrong and wrong not in known:
            known.add(wrong)
            digest = hashlib.sha256(data).hexdigest()[:12]
            (found / f"{name.replace(' ', '-')}-{digest}{reader.suffix}").write_bytes(data)
            print(f"FOUND {wrong}", flush=True)

    flags = [f"-max_total_time={seconds:.0f}", f"-max_len={LARGEST}", "-timeout=60", "-rss_limit_mb=4000", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], *flags, f"-artifact_prefix={found}/{name.replace(' ', '-')}-", str(own)], tried)
    atheris.Fuzz()


def main() -> int:
    """Fuzz the readers one after the other, and add to the record."""
    parser = options(__doc__)
    parser.add_argument("--corpus", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--reader", nargs="*", default=[])
    parser.add_argument("--one", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        one(asked.one, asked.corpus, asked.seconds)
        return 0
    from readers import readers

    asked.corpus.mkdir(parents=True, exist_ok=True)
    record = asked.corpus / "record.jsonl"
    for name in asked.reader or readers():
        words = [sys.executable, __file__, "--one", name, "--corpus", str(asked.corpus), "--seconds", str(asked.seconds)]
        done = subprocess.run(words, capture_output=True, text=True, errors="replace", timeout=asked.seconds + 300.0, check=False)
        text = done.stdout + done.stderr
        units = re.search(r"number_of_executed_units: (\d+)", text)
        cover = re.findall(r"cov: (\d+)", text)
        row = {
            "reader": name, "seconds": asked.seconds, "tried": int(units[1]) if units else 0, "edges": int(cover[-1]) if cover else 0,
            "found": re.findall(r"FOUND (.*)", text) + ([] if units else [f"ended with {done.returncode}"]),
        }  # fmt: skip
        with record.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(row, flush=True)
    rows: list[dict[str, Any]] = [json.loads(line) for line in record.read_text(encoding="utf-8").splitlines()]
    cells = []
    for name in dict.fromkeys(row["reader"] for row in rows):
        own = [row for row in rows if row["reader"] == name]
        inputs = len(list((asked.corpus / name.replace(" ", "-")).glob("*")))
        found = list(dict.fromkeys(text for row in own for text in row["found"]))
        spent, tried = sum(row["seconds"] for row in own), sum(row["tried"] for row in own)
        cells.append([name, f"{spent:.0f}", tried, max(row["edges"] for row in own), inputs, "; ".join(found)[:200] or "nothing"])
    hours, tried = sum(row["seconds"] for row in rows) / 3600.0, sum(row["tried"] for row in rows)
    head = "# Fuzzed readers\n\n`python benchmarks/fuzz_readers.py --corpus FOLDER --write`"
    about = f"{tried} inputs in {hours:.2f} hours. `edges` counts those of lmeasure's code. `found` also lists what is mended by now."
    show(asked, f"{head}\n\n{about}\n\n{table(['reader', 's', 'inputs tried', 'edges', 'corpus', 'found'], cells)}", "fuzz_readers")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
