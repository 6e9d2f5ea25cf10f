"""What a user describes: robot files, the library of robots, exact numbers."""

from symstiff.robot.chain import Chain, Elementary, Row, elementary_chain
from symstiff.robot.exact import Exact, parse_exact
from symstiff.robot.loading import from_table, library, load, parse
from symstiff.robot.schema import GravityCompensator, Joint, Link, Marker, Placement, Robot

__all__ = [
    "Chain",
    "Elementary",
    "Exact",
    "GravityCompensator",
    "Joint",
    "Link",
    "Marker",
    "Placement",
    "Robot",
    "Row",
    "elementary_chain",
    "from_table",
    "library",
    "load",
    "parse",
    "parse_exact",
]
