"""`python -m levelflow`."""

from levelflow.cli import main

main()
