"""`python -m smoother`: the command line, for the interpreter at hand."""

from smoother.cli import main

main()
