"""`lmeasure key`: a key to sign certificates with."""

from pathlib import Path
from typing import Annotated

import typer


def key(
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Private key to write; the public one becomes FILE.pub.")],
) -> None:
    """Make an Ed25519 key: FILE stays with you, FILE.pub goes to those who verify."""
    from lmeasure.certification.signature import new_key

    typer.echo(f"private key {out}, public key {out}.pub\nfingerprint {new_key(out)}")
