"""``python -m conegraph`` is the ``conegraph`` command."""

from conegraph.cli import main

main()
