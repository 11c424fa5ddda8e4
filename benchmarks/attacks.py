"""Attempts to do harm by a file, all of `tests/helpers/readers.py`, on every reader, and by what stands in place of a file.

    python benchmarks/attacks.py [--reader NAME ...] [--first] [--write]

An attempt is harmless if the file is read, or refused in one line, within 5 s of processor time and 700 MB, and if nothing is shown or
written elsewhere. --first writes the column "before" (with PYTHONPATH at the code that is looked at).
A reader ends at ten harmful attempts.
"""

import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from study import options, show, table

ROOT = Path(__file__).parents[1]
sys.path[1:1] = [str(ROOT / "tests" / name) for name in ("helpers", "oracles", "acquisition", "procedures", "rig", "sensors")]

import readers as helper  # noqa: E402
from hostile import no_files  # noqa: E402

from lmeasure.core import LMeasureError  # noqa: E402

RECORD = Path(__file__).parent / "results" / "attacks.jsonl"
ENOUGH = 10


def no_file(reader: helper.Reader, folder: Path) -> Iterator[str]:
    """Yield what is wrong with how a pipe, a folder, an endless device, a circle of links or a closed file is refused."""
    for name, make in no_files(folder).items():
        path = (folder / f"no-{name}").with_suffix(reader.suffix)
        make(path) if not name.startswith("circle") else path.symlink_to(path.name)
        try:
            reader.read(path)
            yield f"{name}: is read"
        except LMeasureError as error:
            yield f"{name}: {error}" if "\n" in str(error) else ""
        except Exception as error:
            yield f"{name}: {type(error).__name__}"
        path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink(missing_ok=True)


def attacked(name: str) -> tuple[int, list[str]]:
    """Return the number of attempts with a reader, and what was wrong."""
    reader, tried, wrong = helper.readers()[name], 0, list[str]()
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as two:
        for content in helper.attempts(reader):
            tried += 1
            wrong += filter(None, [helper.judged(reader, content, Path(one))])
            if len(wrong) == ENOUGH:
                return tried, wrong
        if name not in ("run", "pass", "zip", "scenario"):  # which read the folder around
            for text in no_file(reader, Path(two)):
                tried += 1
                wrong += filter(None, [text])
    return tried, wrong


def main() -> None:
    """Attack all readers, keep what came of it, and show the table."""
    parser = options(__doc__)
    parser.add_argument("--reader", nargs="*", default=list(helper.readers()))
    parser.add_argument("--first", action="store_true")
    arguments = parser.parse_args()
    kept = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    for name in arguments.reader:
        tried, wrong = attacked(name)
        print(name, tried, wrong[:2], flush=True)
        sort = "; ".join(dict.fromkeys(" ".join(text.split())[:60].replace("|", "/") for text in wrong))[:160]
        kept.setdefault(name, {})["before" if arguments.first else "now"] = [tried, len(wrong), sort]
        RECORD.write_text(json.dumps(kept, indent=0))
    none = [0, 0, ""]
    rows = [
        [name, one.get("now", none)[0], f"{'at least ' * (before[1] == ENOUGH)}{before[1]}", before[2], one.get("now", none)[1]]
        for name, one in kept.items()
        for before in [one.get("before", none)]
    ]
    total, through = sum(row[1] for row in rows), sum(row[4] for row in rows)
    head = "# Attacks on the readers\n\n`python benchmarks/attacks.py --write`\n\n"
    about = f"{total} attempts on {len(rows)} readers, {through} of them did harm. Attacks on the workbench have a page of their own."
    show(arguments, f"{head}{about}\n\n{table(['reader', 'attempts', 'harmful before', 'how', 'harmful now'], rows)}", "attacks")


if __name__ == "__main__":
    main()
