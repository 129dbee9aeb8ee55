"""The command line: `orbisim COMMAND ...`. Each command is a module that is loaded when used."""

from orbisim.cli.main import main

__all__ = ["main"]
