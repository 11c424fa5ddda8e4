"""The files of a corrected program."""

import json
from collections.abc import Sequence
from pathlib import Path

from lmeasure.io import files
from lmeasure.report import write_correction_page
from lmeasure.robot_programs import Corrected, Listing, as_record

RECORD, PAGE = "corrections.json", "corrections.html"


def write_correction(out: Path, found: Corrected, listing: Listing, *, inputs: Sequence[Path], language: str) -> list[str]:
    """The corrected files under their names, corrections.json and corrections.html into the folder; their names."""
    names = [source.name for source in listing.sources]
    for name, text in zip(names, found.texts, strict=True):
        files.write_bytes(out / name, text.encode("latin-1"))
    digests = [(path, files.sha256(path)) for path in inputs]
    record = as_record(found, listing, listing.frames)
    record["inputs"] = [{"file": str(path), "sha256": digest} for path, digest in digests]
    files.write_text(out / RECORD, json.dumps(record, indent=1, allow_nan=False) + "\n")
    write_correction_page(out / PAGE, found, listing, inputs=[(p.name, digest) for p, digest in digests], language=language)
    return [*names, RECORD, PAGE]
