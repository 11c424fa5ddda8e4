"""`lmeasure compare`: certificates of one robot over time, or of robots of one type."""

from pathlib import Path
from typing import Annotated

import typer


def compare(
    certificates: Annotated[
        list[Path], typer.Argument(metavar="CERTIFICATE...", help="Folders of certificates, or certificate.json files.")
    ],
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE.json", help="Also write every figure of the comparison.")] = None,
) -> None:
    """Compare certificates: what differs beyond the instrument's uncertainty, what has moved, exchangeability."""
    from lmeasure import files
    from lmeasure.certification.bundle import CERTIFICATE
    from lmeasure.certification.canonical import canonical
    from lmeasure.certification.compare import as_dict, compare_certificates, lines
    from lmeasure.certification.verify import read_certificate

    read = [(str(path), read_certificate(path / CERTIFICATE if path.is_dir() else path)) for path in certificates]
    found = compare_certificates(read)
    if out is not None:
        files.write_text(out, canonical(as_dict(found)).decode("utf-8"))
    typer.echo("\n".join(lines(found)))
