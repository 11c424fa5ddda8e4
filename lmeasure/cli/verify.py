"""`lmeasure verify`: a certificate recomputed from its own folder."""

from pathlib import Path
from typing import Annotated

import typer


def verify(
    bundle: Annotated[Path, typer.Argument(metavar="DIR|FILE.zip", help="Folder or zip that `certify` wrote.")],
    public_key: Annotated[
        Path | None, typer.Option("--public-key", metavar="FILE", help="The signature must be by the owner of this key.")
    ] = None,
) -> None:
    """Look at every byte of a certificate's folder and compute every figure again.

    Exit 0: all the same; 1: every difference on a line; 3: nothing differs, but something could not be compared, named."""
    import tempfile

    from lmeasure.certification.bundle import opened_zip
    from lmeasure.certification.signature import read_public_key
    from lmeasure.certification.verify import told
    from lmeasure.certification.verify import verify as stage
    from lmeasure.cli.progress import bar
    from lmeasure.report.certificate import PRINTERS

    key = None if public_key is None else read_public_key(public_key)
    with tempfile.TemporaryDirectory() as scratch, bar("verify") as progress:
        if bundle.is_dir():
            found = stage(bundle, key, PRINTERS, progress)
        else:
            with opened_zip(bundle, Path(scratch)) as folder:
                found = stage(folder, key, PRINTERS, progress)
    typer.echo("\n".join(told(found, asked=public_key is not None)))
    if found.exit_code:
        raise typer.Exit(found.exit_code)
