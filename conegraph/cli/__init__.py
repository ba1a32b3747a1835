"""The command line, one file a verb group."""

from conegraph.cli.app import main

__all__ = ["main"]
