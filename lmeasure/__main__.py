"""`python -m lmeasure`."""

from lmeasure.cli import main

main()
