"""`python -m lmeasure`."""

from lmeasure.cli import program

program()
