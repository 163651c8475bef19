"""`python -m smoother.cli`: the command line, for the interpreter at hand."""

from smoother.cli import main

main()
