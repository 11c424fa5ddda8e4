"""The command line: one file per command; each parses, calls one function, writes.

Nothing heavy is imported before a command runs, so that `lmeasure --help` answers at once. Exit codes: 0 done; 1 the data cannot give the
answer, said in one line; 2 wrong usage.
"""

import os
import sys
from typing import Annotated

import typer

from lmeasure.cli import (
    calibrate,
    certify,
    check,
    compare,
    demo,
    drum,
    import_,
    key,
    motion,
    place,
    plan_poses,
    program,
    reconstruct,
    record,
    simulate,
    verify,
    view,
    zone,
)
from lmeasure.errors import LMeasureError

INTERRUPTED = 130
"""Exit code of typer where Ctrl-C ended a command."""

app = typer.Typer(
    name="lmeasure",
    help="Cables, drums and encoders as a 6-DOF metrology instrument: from raw counts to the certificate of a robot.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help: drawing it would take three times as long as everything else
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"lmeasure {version('lmeasure')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")] = False,
) -> None:
    pass


app.command("calibrate")(calibrate.calibrate)
app.command("reconstruct")(reconstruct.reconstruct)
app.command("motion")(motion.motion)
app.command("zone")(zone.zone)
app.command("place")(place.place)
app.command("plan-poses")(plan_poses.plan_poses)
app.command("certify")(certify.certify)
app.command("verify")(verify.verify)
app.command("compare")(compare.compare)
app.command("key")(key.key)
app.command("simulate")(simulate.simulate)
app.command("record")(record.record)
app.command("check")(check.check)
app.command("import")(import_.import_)
app.command("view")(view.view)
app.command("drum")(drum.drum)
app.command("program")(program.program)
app.command("demo")(demo.demo)


def main() -> None:
    """Entry point of the `lmeasure` command."""
    # before numpy is loaded: the matrices here are small, and threads of BLAS only wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app()
    except LMeasureError as error:
        print(f"lmeasure: {' '.join(str(error).split())}", file=sys.stderr)
        raise SystemExit(1) from None
    except MemoryError as error:
        print(f"lmeasure: this machine's memory is not enough for what was asked: {' '.join(str(error).split())}", file=sys.stderr)
        raise SystemExit(1) from None
    except SystemExit as end:
        if end.code == INTERRUPTED:  # typer has caught the interrupt, and says nothing
            print("lmeasure: interrupted; nothing was left half-written", file=sys.stderr)
        raise
