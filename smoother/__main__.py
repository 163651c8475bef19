"""`python -m smoother`: the command line, for the interpreter at hand."""

from smoother.cli.main import main

main()
