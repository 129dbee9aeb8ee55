"""Many robots of one scene: a diagnosis for each, and one table of all their effects, in
which robots that differ from the others are marked."""

from orbisim.fleet.run import Fleet, Options, diagnose_fleet
from orbisim.fleet.table import Cell, Robot, Row

__all__ = ["Cell", "Fleet", "Options", "Robot", "Row", "diagnose_fleet"]
