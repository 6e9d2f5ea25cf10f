"""Complete stiffness models of serial robots: derived, reduced, identified, emitted."""

__version__ = "0.1.0"
