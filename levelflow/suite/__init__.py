"""The correctness suite: evolutions whose answer is known, and how far a surface is from it."""

from levelflow.suite.cases import CASES, HALF_WAY, rows
from levelflow.suite.solids import Tube
from levelflow.suite.suite import HEADER, Row, Suite

__all__ = ["CASES", "HALF_WAY", "HEADER", "Row", "Suite", "Tube", "rows"]
