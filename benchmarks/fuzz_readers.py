"""Fuzz every reader of files by coverage (atheris, libFuzzer); each start continues the corpus and the record of the starts before.

    pip install atheris                     (Linux, in the environment of lmeasure)
    python benchmarks/fuzz_readers.py --corpus FOLDER [--seconds S] [--reader NAME ...] [--write]

Readers and right files are those of `tests/helpers/readers.py`. An input that is not read or refused in one line, or that takes too long,
is kept in FOLDER/found.
--seconds are of each reader; 0: only the table. --write writes the table to benchmarks/results/fuzz_readers.md.
"""

import hashlib
import json
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from study import options, show, table

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / name) for name in ("helpers", "oracles", "acquisition", "procedures", "rig", "sensors")]

LARGEST = 20_000
"""Bytes of an input."""


def instrumented() -> Any:
    """Return the block in which what is imported of lmeasure is watched, but for the compiled kernels."""
    import atheris

    kernels = [f"lmeasure.kernels.{path.stem}" for path in (ROOT / "lmeasure" / "kernels").glob("*.py")]
    return atheris.instrument_imports(include=["lmeasure"], exclude=["lmeasure.kernels", *kernels], enable_loader_override=False)


def fuzz(name: str, corpus: Path, seconds: float, log: Path) -> tuple[int, float]:
    """Fuzz one reader in a process of its own until the time is over; libFuzzer ends it. Return its exit status and its processor time."""
    import atheris

    child = os.fork()
    if child:
        _, status, used = os.wait4(child, 0)
        return status, used.ru_utime + used.ru_stime
    out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 1)
    os.dup2(out, 2)
    scratch = Path(tempfile.mkdtemp())
    with instrumented():
        from readers import judged, readers

        reader = readers()[name]
        judged(reader, reader.right, scratch)
    plain = name.replace(" ", "-")
    own, found = corpus / plain, corpus / "found"
    own.mkdir(parents=True, exist_ok=True)
    found.mkdir(exist_ok=True)
    (own / "right").write_bytes(reader.right)
    known: set[str] = set()

    def tried(data: bytes) -> None:
        wrong = re.sub(r"[0-9'\"]+", "", judged(reader, data, scratch))[:80]
        if wrong and wrong not in known:
            known.add(wrong)
            (found / f"{plain}-{hashlib.sha256(data).hexdigest()[:12]}{reader.suffix}").write_bytes(data)
            os.write(1, f"FOUND {wrong}\n".encode())

    flags = [f"-max_total_time={seconds:.0f}", f"-max_len={LARGEST}", "-timeout=60", "-rss_limit_mb=4000", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], *flags, f"-artifact_prefix={found}/{plain}-", str(own)], tried)
    atheris.Fuzz()
    os._exit(1)


def main() -> int:
    """Fuzz the readers one after the other, and add to the record."""
    parser = options(__doc__)
    parser.add_argument("--corpus", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--reader", nargs="*", default=[])
    arguments = parser.parse_args()
    names: list[str] = []
    if arguments.seconds:
        with instrumented():
            from readers import readers

            names = arguments.reader or list(readers())
    arguments.corpus.mkdir(parents=True, exist_ok=True)
    record = arguments.corpus / "record.jsonl"
    for name in names:
        log = arguments.corpus / "log.txt"
        status, spent = fuzz(name, arguments.corpus, arguments.seconds, log)
        text = log.read_text(encoding="utf-8", errors="replace")
        units = re.search(r"number_of_executed_units: (\d+)", text)
        cover = re.findall(r"cov: (\d+)", text)
        row = {
            "reader": name, "seconds": round(spent, 1), "tried": int(units[1]) if units else 0, "edges": int(cover[-1]) if cover else 0,
            "found": re.findall(r"FOUND (.*)", text) + ([] if units else [f"ended with {status}"]),
        }  # fmt: skip
        with record.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(row, flush=True)
    rows: list[dict[str, Any]] = [json.loads(line) for line in record.read_text(encoding="utf-8").splitlines()]
    cells = []
    for name in dict.fromkeys(row["reader"] for row in rows):
        own = [row for row in rows if row["reader"] == name]
        inputs = len(list((arguments.corpus / name.replace(" ", "-")).glob("*")))
        found = list(dict.fromkeys(text for row in own for text in row["found"]))
        spent, tried = sum(row["seconds"] for row in own), sum(row["tried"] for row in own)
        cells.append([name, f"{spent:.0f}", tried, max(row["edges"] for row in own), inputs, "; ".join(found)[:200] or "nothing"])
    hours, tried = sum(row["seconds"] for row in rows) / 3600.0, sum(row["tried"] for row in rows)
    head = "# Fuzzed readers\n\n`python benchmarks/fuzz_readers.py --corpus FOLDER --write`"
    about = (
        f"{tried} inputs in {hours:.2f} processor hours. `edges` counts those of lmeasure's code. `found` also lists what is mended by now."
    )
    show(arguments, f"{head}\n\n{about}\n\n{table(['reader', 's', 'inputs tried', 'edges', 'corpus', 'found'], cells)}", "fuzz_readers")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
